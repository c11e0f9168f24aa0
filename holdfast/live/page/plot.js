// The last seconds: load, grip and target; p(risky); and the situation of every sample as a strip.

const STATES = ["unknown", "nothing", "grasp", "safe_slip", "risky_slip"];
const STRIPES = { unknown: true };
const LINES = { load: ["--load", []], grip: ["--grip", []], target: ["--target", [6, 4]] };
const TITLES = { load: "load along the skin", grip: "grip of either side", target: "target" };
const MARGIN = { left: 44, right: 8, top: 8 };
const STRIP_PX = 18, AXIS_PX = 20, RISK_PX = 44, GAP_PX = 10;
const SAME_SLIP_S = 0.1;
const WIDEST_GAP_S = 0.06;  // rows further apart have lost samples between them

export const inWords = (state) => state.replace("_", " ");

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Draw rows (objects by name) that end at the time `end`, s. */
export function draw(canvas, rows, end, seconds, unit) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui, sans-serif";
  const x = (t) => MARGIN.left + ((t - end + seconds) / seconds) * (width - MARGIN.left - MARGIN.right);
  const below = AXIS_PX + STRIP_PX + RISK_PX + 2 * GAP_PX;
  const bottom = height - below;
  pen.fillStyle = colour("--faint");
  pen.strokeStyle = colour("--line");
  drawTimes(pen, x, end, seconds, height);
  drawForces(pen, x, rows, bottom, width, unit);
  drawRisk(pen, x, rows, bottom + GAP_PX, width);
  drawStrip(pen, x, rows, height - AXIS_PX - STRIP_PX);
  const names = new Labels(width);
  pen.fillStyle = colour("--problem");
  for (const t of slips(rows)) notch(pen, names, x(t), height, "slip");
  pen.fillStyle = colour("--ink");
}

/** Times at which a risky slip begins to be called; one that is called again within 0.1 s is the same. */
function slips(rows) {
  const called = rows.filter((row) => row.state === "risky_slip").map((row) => row.t_s);
  return called.filter((t, k) => k === 0 || t - called[k - 1] > SAME_SLIP_S);
}

/** Where the name of a line may stand: each name on the first row that is free there. */
class Labels {
  constructor(width) { this.width = width; this.ends = []; }

  place(left, wide) {
    const from = Math.min(left, this.width - wide);
    let row = 0;
    while (this.ends[row] > from) row += 1;
    this.ends[row] = from + wide + 6;
    return [from, MARGIN.top + 10 + 13 * row];
  }
}

/** A line over the whole plot with its name; names that come in the order of time do not collide. */
function notch(pen, names, x, height, name) {
  pen.fillRect(x, MARGIN.top, 1.5, height - AXIS_PX - MARGIN.top);
  pen.fillText(name, ...names.place(x + 4, pen.measureText(name).width));
}

function drawTimes(pen, x, end, seconds, height) {
  for (let t = Math.max(0, Math.ceil((end - seconds) / 2) * 2); t <= end; t += 2) {
    pen.beginPath();
    pen.moveTo(x(t), MARGIN.top);
    pen.lineTo(x(t), height - AXIS_PX);
    pen.stroke();
    pen.textAlign = t === end ? "right" : "center";
    if (x(t) > MARGIN.left - 1) pen.fillText(`${t} s`, x(t), height - 5);
  }
  pen.textAlign = "left";
}

function drawForces(pen, x, rows, bottom, width, unit) {
  const values = rows.flatMap((row) => [row.load, row.grip, row.target]).filter((v) => v !== null);
  const most = Math.max(unit === "N" ? 1 : 100, ...values) * 1.05;
  const y = (v) => bottom - (v / most) * (bottom - MARGIN.top);
  for (const part of [0, 0.5, 1]) {
    pen.strokeRect(MARGIN.left, y(part * most), width - MARGIN.left - MARGIN.right, 0);
    const text = `${+(part * most).toPrecision(2)}`;
    pen.fillText(part === 1 ? `${text} ${unit}` : text, 4, y(part * most) + (part ? 10 : 0));
  }
  for (const [name, [shade, dash]] of Object.entries(LINES)) {
    pen.strokeStyle = colour(shade);
    pen.lineWidth = name === "target" ? 2.5 : 1.75;
    pen.setLineDash(dash);
    line(pen, rows, (row) => x(row.t_s), (row) => (row[name] === null ? null : y(row[name])));
  }
  pen.setLineDash([]);
  pen.lineWidth = 1;
}

/** A line that is broken where a value or samples are missing. */
function line(pen, rows, xOf, yOf) {
  pen.beginPath();
  let before = null;
  for (const row of rows) {
    const y = yOf(row);
    if (y !== null) pen[before && row.t_s - before.t_s < WIDEST_GAP_S ? "lineTo" : "moveTo"](xOf(row), y);
    before = y === null ? null : row;
  }
  pen.stroke();
}

function drawRisk(pen, x, rows, top, width) {
  pen.strokeStyle = colour("--line");
  pen.strokeRect(MARGIN.left, top, width - MARGIN.left - MARGIN.right, RISK_PX);
  pen.fillStyle = colour("--faint");
  pen.fillText("1", 30, top + 10);
  pen.fillText("0", 30, top + RISK_PX);
  pen.fillText("p", 6, top + RISK_PX / 2 - 2);
  pen.fillText("risky", 6, top + RISK_PX / 2 + 12);
  pen.strokeStyle = colour("--risk");
  pen.lineWidth = 2;
  line(pen, rows, (row) => x(row.t_s), (row) => (row.p_risky === null ? null : top + (1 - row.p_risky) * RISK_PX));
  pen.lineWidth = 1;
}

function drawStrip(pen, x, rows, top) {
  const shades = Object.fromEntries(STATES.map((state) => [state, colour(`--${state}`)]));
  for (let k = 0; k < rows.length; k += 1) {
    const [row, next] = [rows[k], rows[k + 1]];
    const to = next && next.t_s - row.t_s < WIDEST_GAP_S ? next.t_s : row.t_s + 0.007;
    const left = Math.max(MARGIN.left, x(row.t_s));
    pen.fillStyle = shades[row.state] ?? shades.unknown;
    const tall = STRIPES[row.state] ? STRIP_PX / 2 : STRIP_PX;  // unknown is half as high, not colour alone
    pen.fillRect(left, top + STRIP_PX - tall, Math.max(0.6, x(to) - left + 0.4), tall);
    if (row.act) { pen.fillStyle = colour("--ink"); pen.fillRect(left, top - 4, Math.max(1, x(to) - left), 3); }
  }
}

/** The names of all lines and shades. */
export function legend(list, target) {
  list.replaceChildren();
  const shown = Object.entries(LINES).filter(([name]) => name !== "target" || target);
  for (const [name, [shade, dash]] of shown) item(list, TITLES[name], shade, dash);
  item(list, "p(risky)", "--risk", []);
  for (const state of STATES) item(list, inWords(state), `--${state}`, null, STRIPES[state]);
  item(list, "act requested", "--ink", []);
}

function item(list, text, shade, dash, low) {
  const entry = document.createElement("li");
  const box = dash
    ? `<svg viewBox="0 0 24 12"><path d="M0 6H24" stroke="var(${shade})" stroke-width="3" stroke-dasharray="${dash}"/></svg>`
    : `<svg viewBox="0 0 24 12"><path d="M0 ${low ? 6 : 0}H24V12H0Z" fill="var(${shade})"/></svg>`;
  entry.innerHTML = box;
  entry.append(text);
  list.append(entry);
}

// The page: takes files, runs the hand over them, draws what it answered.
"use strict";

const LINES = { load: "#7a4fb5", grip: "#00857a", target: "#c2691a" };
const MARGIN = { left: 44, right: 8 };
const CLOSE_S = 0.4;
const DRAG_PX = 120;  // doubles the pull

const seconds = (s) => `${s.toFixed(2)} s`;
let hand;
let shown = { trial: null, truth: [], harder: null, answers: [] };

async function open() {
  hand = await openHand(WASM);
  show(readTrial(EXAMPLE.csv, hand.channels()), readTruth(EXAMPLE.truth));
}

function show(trial, truth) {
  shown = { trial, truth, harder: null, answers: [] };
  update();
}

function update() {
  shown.answers = runTrial(hand, shown.trial, shown.harder);
  at("undo").disabled = !shown.harder;
  at("summary").textContent = summary();
  draw();
}

function summary() {
  const { answers, harder } = shown;
  const act = answers.find((one) => one.acts);
  const pull = harder ? `; ${harder.times.toFixed(2)} times the pull from ${seconds(harder.from)} on` : "";
  const asked = act ? `the hand is asked to act at ${seconds(act.t)}` : "the hand is not asked to act";
  return `${answers.length} samples, ${asked}${pull}`;
}

async function take(files) {
  at("problem").textContent = "";
  try {
    const csv = [...files].find((file) => file.name.endsWith(".csv") && !file.name.endsWith(".motion.csv"));
    if (!csv) throw new Error("no CSV of a trial among the files");
    const json = [...files].find((file) => file.name.endsWith(".truth.json"));
    show(readTrial(await csv.text(), hand.channels()), json ? readTruth(await json.text()) : []);
  } catch (error) {
    // the answers of another trial must not stand below the name of this one
    shown = { trial: null, truth: [], harder: null, answers: [] };
    at("summary").textContent = "";
    at("undo").disabled = true;
    draw();
    at("problem").textContent = error.message;
  }
}

/** Pixels of a canvas <-> seconds, for the seconds [from, to]. */
function scales(canvas, [from, to]) {
  const span = Math.max(to - from, 1e-9);
  const width = canvas.clientWidth - MARGIN.left - MARGIN.right;
  return { x: (t) => MARGIN.left + ((t - from) / span) * width, t: (x) => from + ((x - MARGIN.left) / width) * span };
}

const whole = () => [shown.answers[0].t, shown.answers.at(-1).t];

/** Where it matters: around the first act, else around the first risky slip or the middle. */
function closeUp() {
  const [from, to] = whole();
  const first = shown.answers.find((one) => one.acts)?.t ?? shown.truth.find((one) => one.situation === "risky slip")?.from;
  const middle = first ?? (from + to) / 2;
  return [Math.max(from, middle - CLOSE_S), Math.min(to, middle + CLOSE_S)];
}

function draw() {
  if (!shown.answers.length) {
    for (const id of ["plot", "close"]) penOf(at(id));  // which clears it
    return;
  }
  drawOn(at("plot"), whole());
  drawOn(at("close"), closeUp());
}

function drawOn(canvas, range) {
  const pen = penOf(canvas);
  const ink = getComputedStyle(document.body).color;
  const { x } = scales(canvas, range);
  const bottom = canvas.clientHeight - 76;
  pen.save();
  pen.beginPath();
  pen.rect(MARGIN.left, 0, canvas.clientWidth - MARGIN.left - MARGIN.right, canvas.clientHeight);
  pen.clip();
  const most = drawForces(pen, x, ink, bottom);
  drawStrip(pen, x, bottom + 12, phasesOf(shown.answers));
  drawStrip(pen, x, bottom + 34, shown.truth);
  pen.restore();
  drawScales(pen, x, ink, range, bottom, most);
}

function drawForces(pen, x, ink, bottom) {
  const { answers } = shown;
  // a command may be many times the grip: it is cut off at the top, and its number stands there
  const most = 1.4 * Math.max(0.5, ...answers.flatMap((one) => [one.load, one.grip]).filter(Number.isFinite));
  const y = (n) => bottom - Math.min(1, n / most) * (bottom - 24);
  for (const [name, colour] of Object.entries(LINES)) {
    pen.strokeStyle = colour;
    pen.lineWidth = name === "target" ? 2.5 : 1.5;
    pen.setLineDash(name === "target" ? [6, 4] : []);
    pen.beginPath();
    let down = false;
    for (const one of answers) {
      const wanted = Number.isFinite(one[name]) && !(name === "target" && one.target === 0);
      if (wanted) pen[down ? "lineTo" : "moveTo"](x(one.t), y(one[name]));
      down = wanted;
    }
    pen.stroke();
  }
  pen.setLineDash([]);
  pen.fillStyle = ink;
  for (const one of answers.filter((each, k) => each.acts && !answers[k - 1]?.acts)) {
    pen.fillRect(x(one.t), 8, 1.5, bottom - 8);
    pen.fillText(`act, ${Math.round(one.target)} N`, x(one.t) + 4, 16);
  }
  return most;
}

function drawStrip(pen, x, top, phases) {
  for (const one of phases) {
    pen.fillStyle = COLOURS[one.situation] ?? COLOURS.unknown;
    pen.fillRect(x(one.from), top, Math.max(1, x(one.to) - x(one.from)), 18);
  }
}

function drawScales(pen, x, ink, [from, to], bottom, most) {
  pen.fillStyle = ink;
  for (const part of [0, 0.5, 1]) pen.fillText(`${(part * most).toPrecision(2)} N`, 2, bottom - part * (bottom - 24) + 4);
  pen.fillText("model", 2, bottom + 25);
  pen.fillText(shown.truth.length ? "truth" : "no truth file", 2, bottom + 47);
  const apart = [0.1, 0.2, 0.5, 1, 2, 5, 10].find((s) => (to - from) / s <= 11) ?? 60;
  for (let k = Math.ceil(from / apart); k * apart <= to; k += 1) pen.fillText(`${+(k * apart).toFixed(1)} s`, x(k * apart) - 10, bottom + 70);
}

function phasesOf(answers) {
  const phases = [];
  for (const one of answers) {
    const last = phases.at(-1);
    if (last && last.situation === one.situation) last.to = one.t;
    else phases.push({ from: last ? last.to : one.t, to: one.t, situation: one.situation });
  }
  return phases;
}

/** Dragging on a canvas changes the pull from there on. range: the seconds that it shows. */
function draggable(canvas, range) {
  let start = null;
  canvas.addEventListener("pointerdown", (event) => {
    if (!shown.trial) return;
    start = { y: event.clientY, from: scales(canvas, range()).t(event.offsetX) };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!start) return;
    shown.harder = { from: start.from, times: 2 ** ((start.y - event.clientY) / DRAG_PX) };
    update();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { start = null; });
}

function listen() {
  draggable(at("plot"), whole);
  draggable(at("close"), closeUp);
  at("undo").addEventListener("click", () => { shown.harder = null; update(); });
  at("files").addEventListener("change", (event) => take(event.target.files));
  for (const name of ["dragover", "dragleave", "drop"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      at("drop").classList.toggle("over", name === "dragover");
      if (name === "drop") take(event.dataTransfer.files);
    });
  }
  window.addEventListener("resize", draw);
}

fillLegend(at("legend"), COLOURS, { "load along the skin": LINES.load, "grip of either side": LINES.grip, "grip command": LINES.target });
open().then(listen).catch((error) => { at("problem").textContent = error.message; });

// The page of a live run: takes frames from the server, and shows them; never a frozen answer.

import { build, show as showHand } from "./hand.js";
import { draw, inWords, legend } from "./plot.js";

const SILENT_S = 0.5, LOST_MS = 1500, SPEAK_MS = 1000, RETRY_MS = 2000, SPOKEN_S = 2, RISK_ECHO_S = 5, MOST_SAID = 40;
const SENSORS = {
  nack: "does not answer", missing: "does not answer, it is looked for", mux: "its multiplexer did not switch", stale: "has stopped measuring",
  garbage: "sends no measurement", crc: "its checksum is wrong", reset: "has lost its power", diagnosis: "reports a fault of its own",
  saturated: "field too strong (saturated)", settling: "is starting", lost: "the bridge is gone", bridge: "the bridge fails", stuck: "the bus is held low",
};
const REASONS = {
  settling: "the history is not whole yet", sensors: "too few sensors can be used", repeats: "the whole hand repeats itself",
  rate: "the sampling rate is not the model's", started_loaded: "the hand was loaded at the start; open it once",
  late: "the answer is late", clock: "the sample's time lies in the future",
};
const RANKS = ["nothing", "grasp", "safe_slip", "unknown", "risky_slip"];

const at = (id) => document.getElementById(id);
const number = (value, places = 2) => (value === null || value === undefined ? "–" : value.toFixed(places).replace(/^-(0\.?0*)$/, "$1"));

const placesOf = (unit) => (unit === "N" ? 2 : 0);

const page = { about: null, sample: null, rows: [], ended: "", silent: null, heardMs: 0, hand: null, paused: null, spokenMs: -SPEAK_MS, riskyAt: null };

// -- what the server sends

function connect() {
  const source = new EventSource("events");
  source.addEventListener("whole", (event) => { begin(JSON.parse(event.data)); });
  source.addEventListener("frame", (event) => { if (page.about) take(JSON.parse(event.data)); });
  source.onerror = () => { if (source.readyState === EventSource.CLOSED) setTimeout(connect, RETRY_MS); };
}

function begin(whole) {
  Object.assign(page, { rows: [], sample: null, riskyAt: null, ended: "" });
  at("said").replaceChildren();
  take(whole, true);
}

function introduce(about) {
  page.about = about;
  const { model, source, unit } = about;
  at("about").textContent = [model, source, unit].join(" · ");
  legend(at("legend"), about.grip);
  at("moves").textContent = about.grip ? "This page only shows; the run that it shows sends grip targets to a hand." : "This page only shows; it moves no hand.";
}

function take(frame, isWhole = false) {
  page.heardMs = performance.now();
  if (frame.about) introduce(frame.about);
  const fresh = frame.rows.map((cells) => Object.fromEntries(page.about.rows.map((name, k) => [name, cells[k]])));
  if (frame.restarts) Object.assign(page, { rows: [], riskyAt: null });
  page.rows.push(...fresh);
  for (const line of frame.said ?? []) say(line);
  if (frame.ended && !page.ended) say(frame.ended);
  Object.assign(page, { sample: frame.sample, ended: frame.ended, silent: frame.silent_s });
  const newest = page.rows.at(-1);
  while (page.rows.length && page.rows[0].t_s < newest.t_s - page.about.shown_s) page.rows.shift();
  const risky = fresh.findLast((row) => row.state === "risky_slip");
  if (risky) page.riskyAt = risky.t_s;
  showState(isWhole ? null : riskiest(fresh));  // the rows of a whole picture are the past
  if (page.paused === null) showPicture();
  showNumbers();
}

const riskiest = (rows) => rows.reduce((most, row) => (RANKS.indexOf(row.state) > RANKS.indexOf(most) ? row.state : most), rows[0]?.state ?? null);

// -- the state, in words

/** What is wrong with the connection or the loop, as [headline, detail]; null where nothing is. */
function trouble() {
  // the last message is no reason: it was said before, and may ask for something that is over
  if (page.ended) return [page.ended, "what is shown below is its last picture"];
  const silentMs = performance.now() - page.heardMs;
  if (!page.heardMs || silentMs > LOST_MS) return ["no connection", "no data comes from the program: the state is not known"];
  if (page.silent === null) return ["waiting", at("said").firstChild?.textContent ?? "no sample has come yet"];
  if (page.silent > SILENT_S) return ["no answers", `the loop has sent nothing for ${number(page.silent, 1)} s: the state is not known`];
  return null;
}

function showState(newest) {
  const wrong = trouble();
  document.body.classList.toggle("gone", wrong !== null);
  at("echo").textContent = "";
  if (wrong) { headline("unknown", ...wrong); return; }
  if (!page.sample) return;
  const state = newest ?? page.sample.answer.state;
  const agoS = page.riskyAt === null ? Infinity : page.sample.t_s - page.riskyAt;
  // a slip lasts a few samples: it stays beside the state until a person has seen it
  if (state !== "risky_slip" && agoS < RISK_ECHO_S) at("echo").textContent = `risky slip ${number(agoS, 1)} s ago`;
  headline(state, inWords(state), details(page.sample.answer, state).join("; "), agoS < SPOKEN_S ? "risky slip" : inWords(state));
  const p = state === "unknown" ? null : page.rows.at(-1).p_risky;
  at("risk-bar").value = p ?? 0;
  at("risk-value").textContent = number(p);
}

const sensors = () => page.about.hand.filter((one) => one.sensed);
const names = () => sensors().map((one) => one.name);

function details(answer, state) {
  const lost = names().filter((_, k) => !page.sample.v[k]);
  return [
    state === "unknown" && (REASONS[answer.why] ?? answer.why),
    lost.length > 0 && (lost.length === page.sample.v.length ? "no sensor is read" : `lost: ${lost.join(", ")}`),
    answer.act && "the hand is asked to act",
    answer.weight && state !== "unknown" && `${answer.weight} object`,
    answer.degraded && "some sensors are missing",
    answer.opening && "the wearer opens the hand: no target counts",
    answer.overridden && "the user overrides",
    answer.commands === "expired" && "the user's commands have stopped",
    answer.started_loaded && "the hand was loaded at the start",
  ].filter(Boolean);
}

/** spoken: what a screen reader says, which must not miss a short slip. */
function headline(state, text, detail, spoken = text) {
  at("now").dataset.state = state;
  at("state").textContent = text;
  at("detail").textContent = detail;
  const now = performance.now();
  if (at("spoken").textContent !== spoken && now - page.spokenMs > SPEAK_MS) {
    at("spoken").textContent = spoken;
    page.spokenMs = now;
  }
}

// -- pictures and numbers

function showPicture() {
  const { sample, about } = page;
  if (!sample) return;
  if (page.hand !== about.hand) buildSensors();
  at("hand-scale").textContent = showHand(sample.forces, sample.v, about.unit);
  showSensors(sample);
  drawPlot();
}

function drawPlot() {
  const rows = page.paused?.rows ?? page.rows;
  const end = Math.max(page.about?.shown_s ?? 0, rows.at(-1)?.t_s ?? 0);
  if (page.about) draw(at("plot"), rows, end, page.about.shown_s, page.about.unit);
}

function buildSensors() {
  page.hand = page.about.hand;
  build(at("hand"), page.hand);
  const body = at("sensors").tBodies[0];
  body.replaceChildren();
  for (const name of names()) {
    const row = body.insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    head.textContent = name;
    row.append(head);
    for (let cell = 0; cell < 3; cell += 1) row.insertCell();
  }
}

function showSensors({ forces, v, why }) {
  const { unit } = page.about;
  const places = placesOf(unit);
  [...at("sensors").tBodies[0].rows].forEach((row, k) => {
    const [x, y, z] = forces[k];
    const along = x === null || y === null ? null : Math.hypot(x, y);
    row.className = v[k] ? "" : "lost";
    row.cells[1].textContent = v[k] ? `${number(z, places)} ${unit}` : "–";
    // an axis that the sensor does not measure is a dash, and no zero
    const unmeasured = ["x", "y"].filter((axis) => !sensors()[k].measures.includes(axis));
    const dashes = unmeasured.map((axis) => `, ${axis} –`).join("");
    row.cells[2].textContent = v[k] ? `${number(along, places)} ${unit}${dashes}` : "–";
    row.cells[3].textContent = v[k] ? "good" : SENSORS[why[k]] ?? (why[k] || "no new reading, or its bias is not known");
  });
}

/** What the wearer wants. */
function wearer({ wants, link }) {
  if (link !== "live") return link === "none" ? "unknown: nothing has come yet" : "unknown: its sender is silent";
  return wants;
}

/** The newest command, or that none reaches the hand. */
function target(grip, force) {
  if (!grip.leaves) return "NO COMMAND LEAVES: the hand holds its grip";
  return `${grip.target_n === null ? "none" : force(grip.target_n)} (${grip.mode}: ${grip.reason})`;
}

/** So many samples span one period fewer. */
const rate = (rows) => (rows.length > 1 ? `${number((rows.length - 1) / (rows.at(-1).t_s - rows[0].t_s), 1)} Hz` : "–");

function showNumbers() {
  const { sample, about } = page;
  if (!sample) return;
  const last = page.rows.at(-1);
  const force = (value) => (value === null || value === undefined ? "–" : `${number(value, placesOf(about.unit))} ${about.unit}`);
  const figures = { "grip of either side": force(last?.grip), "load along the skin": force(last?.load) };
  const { grip, answer } = sample;
  figures["target"] = about.grip ? target(grip, force) : "no controller runs (--grip)";
  if (about.grip) figures["friction margin"] = grip.margin === null ? "not known before a slip" : `${number(grip.margin)} (friction ${number(grip.mu_hat)})`;
  figures["latency"] = `${number(1e-3 * answer.latency_us)} ms`;
  figures["request"] = answer.act ? "act" : answer.arm ? "arm" : "none";
  if (sample.intent) figures["wearer's command"] = wearer(sample.intent);
  figures["rate"] = rate(page.rows.filter((row) => row.t_s > last.t_s - 1));
  figures["lost samples"] = sample.lost === 0 ? "none" : `${sample.lost} in this run`;
  if (sample.unsent) figures["not shown here"] = `${sample.unsent} messages that this page missed`;
  const list = at("numbers");
  list.replaceChildren(...Object.entries(figures).flatMap(([name, text]) => {
    const [term, value] = [document.createElement("dt"), document.createElement("dd")];
    term.textContent = name;
    value.textContent = text;
    return [term, value];
  }));
}

function say(line) {
  const item = document.createElement("li");
  item.textContent = line;
  at("said").prepend(item);
  while (at("said").children.length > MOST_SAID) at("said").lastChild.remove();
}

// -- controls

/** The pictures stand still; the state, the numbers and the connection go on. */
function togglePause() {
  const pause = at("pause");
  page.paused = page.paused === null ? { rows: [...page.rows] } : null;
  pause.setAttribute("aria-pressed", String(page.paused !== null));
  pause.textContent = page.paused ? "Resume" : "Pause";
  at("note").textContent = page.paused ? "The pictures and the table of sensors stand still; the state and the numbers continue." : "";
  if (!page.paused) showPicture();
}

connect();
at("pause").addEventListener("click", togglePause);
setInterval(() => { if (trouble()) showState(null); }, 250);
window.addEventListener("resize", drawPlot);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawPlot);

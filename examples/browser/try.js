// The page: a world that goes on while it is seen, and what a person does to it.
"use strict";

const RATE = 150;
const [BEGINS_S, GIVES_S, READY_S] = [1.0, 1.6, 3.5];  // try.c closes the hand from 1 s on; then the giver lets go
const FRICTION_AT = 42;  // in `setup` of try.c, as is the mass at 0 and gravity at 1
const G = 9.81;
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const TIGHTEN = 2;  // of the modes in holdfast.h
const REACH_MM = 80;  // of a pull by key
const TEAR = { mm: 130, lasts_s: 0.55 };  // of the button's pull
const still = window.matchMedia("(prefers-reduced-motion: reduce)");
const now = { hand: null, view: null, rows: [], action: null, draw: null, dragged: null, plan: [], last: null, owed: 0, seed: 1, alarm: -1 };

const held = () => OBJECTS.find((one) => one.name === at("object").value);
const degrees = () => Number(at("turn").value);
const speed = () => Number(document.querySelector("input[name=speed]:checked").value);

const TURNS = { 0: "upright", 90: "fingers below", "-90": "thumb below", 180: "upside down", "-180": "upside down" };
const turnName = () => TURNS[degrees()] ?? `turned by ${degrees()}°`;

/** The world's numbers by name; vectors in the hand's frame. */
function look() {
  const all = new Float64Array(now.hand.memory.buffer, now.hand.seen(), now.hand.seen_count());
  const vector = (from) => [...all.slice(from, from + 3)];
  return { t: all[0], position: vector(1), people: vector(4), pull: vector(7), grip: all[10], load: all[13], touching: all[15], gap: all[17], supports: all[18], takes: all[19] };
}

/** A new trial of what the controls say, up to a hand that holds. weak: too weak a grip, and the giver stays. */
function start(weak) {
  const setup = new Float64Array(now.hand.memory.buffer, now.hand.setup(), now.hand.setup_count());
  const one = held();
  const friction = Number(at("friction").value);
  setup.set(one.setup);
  setup.set([friction, friction * one.kinetic_share], FRICTION_AT);
  const turn = (degrees() * Math.PI) / 180;
  setup.set([G * Math.sin(turn), 0, -G * Math.cos(turn)], 1);
  const least = (setup[0] * G) / (2 * friction * one.kinetic_share);
  setup[setup.length - 1] = weak ? Math.max(0.4, 0.5 * least) : Math.max(3, 1.6 * least);
  if (now.hand.start(now.seed++) !== 0) throw new Error("this page was built from parts that do not fit");
  Object.assign(now, { rows: [], dragged: null, plan: [], owed: 0, alarm: -1, view: look() });
  now.action = actionOf(null, now.view);
  now.draw = stageOf(at("stage"), one, degrees());
  while (now.view.t < READY_S) {
    if (!weak && Math.abs(now.view.t - GIVES_S) < 0.5 / RATE) now.hand.let_go(0.3);
    sample();
  }
  now.rows = now.rows.filter((row) => row.t > BEGINS_S);
}

/** One sample: the world, the answer, and what happened. */
function sample() {
  const t = now.view.t;
  while (now.plan.length && now.plan[0].t <= t) now.plan.shift().act();
  if (now.hand.advance(at("helped").checked ? 1 : 0) !== 0) throw new Error("a sample was refused");
  now.view = look();
  const situation = ["unknown", "nothing", "grasp", "safe slip", "risky slip"][1 + now.hand.label()];
  const tightens = now.hand.mode() === TIGHTEN;
  const called = tightens || now.hand.acts() === 1;
  if (tightens || (called && !now.rows.at(-1)?.called)) now.alarm = t;
  now.rows.push({ t, situation, called, load: now.view.load, grip: now.view.grip });
  if (now.rows.length > 2 * RATE) now.rows.shift();
  follow(now.action, t, called, now.view);
}

/** Begin an action; what: its plan, [{after_s, act}]. */
function begin(kind, what) {
  now.action = actionOf(kind, now.view);
  now.plan = what.map(({ after_s, act }) => ({ t: now.view.t + after_s, act }));
}

const ends = () => { now.action.ended = now.view.t; };
function release() {
  now.hand.release();
  ends();
}

function pullBy([right, down]) {
  const [x, z] = toHand([right / 1e3, down / 1e3], degrees());
  const [x0, y0, z0] = now.dragged.from;
  now.hand.pull_to(x0 + x, y0, z0 + z);
}

/** A pull begins: an object that is gone is given back first. */
function grab() {
  if (now.view.touching === 0) start(false);
  begin("pull", []);
  now.dragged = { from: now.view.position, at: null };
}

function letLoose() {
  if (!now.dragged) return;
  now.dragged = null;
  release();
}

function place(event) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(at("stage").getScreenCTM().inverse());
  return [point.x, point.y];
}

function listen() {
  const stage = at("stage");
  stage.addEventListener("pointerdown", (event) => {
    grab();
    now.dragged.at = place(event);
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    if (now.dragged?.at) pullBy(place(event).map((mm, k) => mm - now.dragged.at[k]));
  });
  for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, letLoose);
  stage.addEventListener("keydown", (event) => {
    if (!KEYS[event.key]) return;
    event.preventDefault();
    if (!now.dragged) grab();
    pullBy(KEYS[event.key].map((part) => part * REACH_MM));
  });
  stage.addEventListener("keyup", (event) => { if (KEYS[event.key]) letLoose(); });
  stage.addEventListener("blur", letLoose);
  at("pull").addEventListener("click", tear);
  at("hand-over").addEventListener("click", () => {
    start(false);
    begin("hand-over", [{ after_s: 0, act: () => now.hand.take_over() }]);
  });
  at("open").addEventListener("click", letGo);
  at("drop").addEventListener("click", () => {
    start(true);
    begin("drop", [{ after_s: 0.1, act: () => now.hand.let_go(0.04) }, { after_s: 0.6, act: ends }]);
  });
  at("again").addEventListener("click", () => start(false));
  at("object").addEventListener("change", () => { at("friction").value = held().friction; });
  for (const id of ["object", "friction", "turn", "helped"]) at(id).addEventListener("input", restart);
  document.querySelector("form").addEventListener("submit", (event) => event.preventDefault());
}

/** The wearer opens the hand, in a hand-over or without a receiver. */
function letGo() {
  if (now.view.touching === 0) return;
  letLoose();
  if (now.action.kind !== "hand-over") begin("open", []);
  now.hand.open_hand();
  now.action.opened ??= now.view.t;
  now.action.began ??= now.view.t;
  ends();
}

function tear() {
  start(false);
  now.dragged = { from: now.view.position, at: null };
  begin("pull", [{ after_s: 0.05, act: () => pullBy([0, TEAR.mm]) }, { after_s: TEAR.lasts_s, act: letLoose }]);
}

function restart() {
  if (document.activeElement === at("object")) at("friction").value = held().friction;
  start(false);
}

function show() {
  const { view, action } = now;
  const alarm = now.alarm >= 0 && view.t - now.alarm < 0.3;
  now.draw(view, alarm);
  drawStrip(at("strip"), now.rows);
  const { situation, called } = now.rows.at(-1);
  at("alarm").dataset.on = alarm ? "yes" : "no";
  const slip = action.opened === null ? "Slip! The grip is about to fail." : "Called a slip. The hand opens all the same.";
  write(at("alarm").firstChild, alarm ? slip : called ? "A slip was called." : `Answer: ${situation}`);
  for (const [id, n] of [["grip", view.grip], ["load", view.load], ["force", Math.hypot(...view.pull)]]) write(at(id), `${n.toFixed(1)}\u00a0N`);
  write(at("friction-is"), Number(at("friction").value).toFixed(2));
  write(at("turn-is"), turnName());
  at("turn").ariaValueText = turnName();
  const said = action.said ?? sentenceOf(action, view, at("helped").checked);
  if (said.end) action.said = said;
  write(at("said"), said.text);
  at("said").dataset.end = said.end;
}

/** A text that changes only where it differs, so that a screen reader hears it once. */
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function frame(time) {
  const passed = now.last === null ? 0 : Math.min(time - now.last, 60) / 1e3;
  now.last = time;
  // a page that should not move stands still until something is done to the object
  const moves = !still.matches || now.dragged || (now.action.kind && !now.action.said);
  const gone = now.view.touching === 0 && now.action.said;
  if (moves && !gone) now.owed += passed * speed() * RATE;
  for (; now.owed >= 1; now.owed -= 1) sample();
  show();
  requestAnimationFrame(frame);
}

async function open() {
  now.hand = await openHand(WASM);
  for (const one of OBJECTS) at("object").append(new Option(`${one.name.replace("-", " ")}, ${Math.round(one.mass_g)} g`, one.name));
  at("object").value = "full-bottle";
  at("friction").value = held().friction;
  fillLegend(at("legend"), COLOURS, { "load along the skin": "var(--pull)", "grip of either side": "var(--arrow)" });
  start(false);
  listen();
  requestAnimationFrame(frame);
}

open().catch((error) => { at("problem").textContent = error.message; });

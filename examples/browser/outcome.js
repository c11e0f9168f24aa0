// What happened, in one sentence: when it began, when a slip was called, whether the object was kept.
"use strict";

const LOAD_N = 0.1;  // from this change on a person's force counts, as in the scenes
const AFTER_S = 0.4;  // this long after the pull the end is known
const KINDS = {
  pull: { began: "the pull began", lasts: "Pulling." },
  drop: { began: "the support went", lasts: "The support goes." },
  "hand-over": { began: "the receiver took hold", lasts: "A receiver takes it; the wearer opens the hand." },
};

/** An action that begins with this view. kind: a name of KINDS, or null for a hand that holds. */
function actionOf(kind, view) {
  return { kind, base: view.people, place: view.position, began: null, called: null, lost: null, peak: view.grip, grip: view.grip, ended: null, said: null };
}

/** One sample into an action. called: whether the hand is asked to tighten; t: its time; view: the world after it. */
function follow(action, t, called, view) {
  if (!action.kind || action.said) return;
  const change = Math.hypot(...view.people.map((n, k) => n - action.base[k]));
  if (action.began === null && change > LOAD_N) action.began = t;
  if (action.began === null) return;
  if (called && action.called === null && action.lost === null) action.called = t - action.began;
  if (view.touching === 0 && action.lost === null) action.lost = view.t - action.began;
  if (action.lost === null) action.peak = Math.max(action.peak, view.grip);
}

const ms = (s) => `${Math.round(1e3 * s)}\u00a0ms`;

/** The sentence of an action, and whether it ended well: {text, end: "", "good" or "bad"}. */
function sentenceOf(action, view, helped) {
  const kind = KINDS[action.kind];
  if (!kind) return { text: "Held. Pull it.", end: "" };
  const call = action.called === null ? "no slip was called" : `called ${ms(action.called)} after ${kind.began}`;
  const rose = action.peak > action.grip + 0.5 ? `the grip rose to ${action.peak.toFixed(0)}\u00a0N` : `the grip stayed at ${action.grip.toFixed(1)}\u00a0N`;
  if (action.kind === "hand-over") return handedOver(action, view, call, rose);
  if (action.lost !== null) {
    const why = helped ? `${call}, ${rose}, but not in time.` : `${call.replace("called", "Holdfast would have called it")}, but the grip is the wearer's alone.`;
    return { text: `Lost after ${ms(action.lost)}: ${why}`, end: "bad" };
  }
  if (action.ended === null || view.t < action.ended + AFTER_S) {
    return { text: action.called === null ? kind.lasts : `${kind.lasts} Slip ${call}.`, end: "" };
  }
  const slid = 1e3 * Math.hypot(...view.position.map((m, k) => m - action.place[k]));
  return { text: `Kept: ${call}, ${rose}; it slid ${slid.toFixed(0)}\u00a0mm.`, end: "good" };
}

function handedOver(action, view, call, rose) {
  if (action.lost === null && (action.ended === null || view.t < action.ended + 3)) return { text: KINDS["hand-over"].lasts, end: "" };
  if (action.lost === null) return { text: `Held too long: ${call}, ${rose}.`, end: "bad" };
  if (action.called === null) return { text: `Handed over, let go after ${ms(action.lost)}: ${call}, ${rose}.`, end: "good" };
  const held = action.peak > action.grip + 0.5;
  return { text: `Handed over after ${ms(action.lost)}: ${call}, ${held ? `and ${rose}` : "but the grip followed the wearer, who was opening the hand"}.`, end: held ? "bad" : "good" };
}

// What happened, in one sentence: when it began, when a slip was called, whether the object was kept.
"use strict";

const LOAD_N = 0.1;  // from this change on a person's force counts, as in the scenes
const AFTER_S = 0.4;  // this long after the pull the end is known
const KINDS = {
  pull: { began: "the pull began", lasts: "Pulling." },
  drop: { began: "the support went", lasts: "The support goes." },
  "hand-over": { began: "the receiver took hold", lasts: "A receiver takes it. You are the wearer: open the hand." },
  open: { began: "the hand opened", lasts: "The wearer opens the hand." },
};

/** An action that begins with this view. kind: a name of KINDS, or null for a hand that holds. */
function actionOf(kind, view) {
  return { kind, base: view.people, place: view.position, began: null, called: null, lost: null, opened: null, peak: view.grip, grip: view.grip, ended: null, said: null };
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
  if (action.kind === "hand-over" || action.kind === "open") return opened(action, kind);
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

/** The hand obeys its wearer, so only the time from the opening on is of interest. */
function opened(action, kind) {
  if (action.lost === null) return { text: kind.lasts, end: "" };
  if (action.opened === null) return { text: "Taken before the wearer opened.", end: "bad" };
  const after = ms(action.began + action.lost - action.opened);
  return { text: `Let go ${after} after the wearer opened, from ${action.peak.toFixed(0)}\u00a0N, whatever Holdfast asked for.`, end: "good" };
}

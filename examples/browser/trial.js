// A trial and a hand: read a CSV, feed every sample, keep what is answered. No page is needed.
"use strict";

const SITUATIONS = ["unknown", "nothing", "grasp", "safe slip", "risky slip"];
const MODES = ["idle", "hold", "tighten", "relax", "yield"];

/** A cell as a number: a word for a flag counts, an empty one is none. */
function numberOf(cell) {
  const word = cell.trim().toLowerCase();
  return word === "" ? NaN : word === "true" ? 1 : word === "false" ? 0 : Number(word);
}

/** A CSV with Time, then x y z of every sensor, and maybe valid1, valid2 ..
 *  -> {times: s, rows: numbers, valid: 0 or 1 of every sensor}. Throws an Error that says why. */
function readTrial(text, channels) {
  const lines = text.split(/\r?\n/).filter((line) => line && !line.startsWith("#"));
  const names = (lines[0] ?? "").split(",").map((name) => name.trim());
  const flags = names.indexOf("valid1");
  const numbers = (line) => line.split(",").map(numberOf);
  const all = lines.map(numbers).filter((row) => Number.isFinite(row[0]));
  if (all.length < 2) throw new Error("no samples: a line needs Time and x, y, z of every sensor");
  const sensors = channels / 3;
  if (names.includes(`X${sensors + 1}`)) throw new Error(`the trial has more sensors than the model's ${sensors}`);
  const needed = flags < 0 ? 1 + channels : flags + sensors;
  const short = all.find((row) => row.length < needed);
  if (short) throw new Error(`a line has ${short.length} numbers; this model needs Time and ${channels} more`);
  return {
    times: all.map((row) => row[0]),
    rows: all.map((row) => row.slice(1, 1 + channels)),
    valid: all.map((row) => (flags < 0 ? Array(sensors).fill(1) : row.slice(flags, flags + sensors))),
  };
}

/** A truth file of a simulated or recorded trial -> [{from, to, situation}], in s; [] where it has none. */
function readTruth(text) {
  const phases = JSON.parse(text).phases ?? [];
  return phases.map((one) => ({ from: one.t0_s, to: one.t1_s, situation: one.label.replace("_", " ") }));
}

/** Throws an Error where a trial is not at the hand's rate (+-10 %, as in Holdfast), or its time does not rise. */
function requireRate(times, rateHz) {
  const steps = times.slice(1).map((t, k) => t - times[k]);
  const bad = steps.findIndex((step) => !(step > 0));
  if (bad >= 0) throw new Error(`the time does not rise at sample ${bad + 1}: ${times[bad]} s, then ${times[bad + 1]} s`);
  const middle = [...steps].sort((a, b) => a - b)[steps.length >> 1];
  if (Math.abs(1 / (middle * rateHz) - 1) > 0.1) throw new Error(`this trial has ${(1 / middle).toPrecision(3)} samples a second; the model needs ${rateHz}`);
}

/** Every sample through the hand. harder: {from: s, times: factor} multiplies forces along the skin. */
function runTrial(hand, trial, harder) {
  const channels = hand.channels();
  const sample = new Float64Array(hand.memory.buffer, hand.samples(), channels);
  const valid = new Uint8Array(hand.memory.buffer, hand.valids(), channels / 3);
  const lost = 1.5 / hand.rate_hz();
  requireRate(trial.times, hand.rate_hz());
  hand.begin();
  return trial.rows.map((row, k) => {
    const t = trial.times[k];
    // samples that never came are steps without a sensor; a longer gap is no different
    valid.fill(0);
    const missing = k ? (t - trial.times[k - 1] - lost) * hand.rate_hz() : 0;
    for (let gap = 0; gap <= hand.gap_samples() && gap < missing; ++gap) hand.step();
    sample.set(row);
    valid.set(trial.valid[k]);
    if (hand.feed(harder && t >= harder.from ? harder.times : 1) !== 0) throw new Error(`sample ${k} was refused`);
    const unbiased = hand.known() === 1;
    let grip = unbiased ? 0 : NaN;
    let load = grip;
    for (let c = 0; c < channels; c += 3) {
      const finger = [sample[c], sample[c + 1], sample[c + 2]];
      if (finger.some(Number.isNaN)) continue;
      grip += Math.max(finger[2], 0) / 2;
      load += Math.hypot(finger[0], finger[1]);
    }
    return {
      t, grip, load,
      situation: SITUATIONS[1 + hand.label()],
      risky: hand.risky(),
      acts: hand.acts() === 1,
      mode: MODES[hand.mode()],
      target: hand.target_n(),
    };
  });
}

if (typeof module !== "undefined") module.exports = { readTrial, readTruth, runTrial };

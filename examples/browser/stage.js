// The picture: a hand from the side, what it holds, and who pulls. Its units are mm; the hand's x goes to the right and its z up,
// and the whole is turned so that gravity always points down the page.
"use strict";

const PAD_MM = 16;
const ARROW_MM_PER_N = 2.2;
const svgOf = (name, attributes, parent) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent.append(made);
  return made;
};

/** A vector of the hand's frame (x, z) <-> one of the page (right, down), the hand turned by some degrees. */
function toPage([x, z], degrees) {
  const [c, s] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
  return [x * c + z * s, x * s - z * c];
}
const toHand = toPage;  // a reflection is its own inverse

/** Draws an object's shape around 0, 0. */
function drawObject(parent, held) {
  const { radius_mm: r, half_tall_mm: h } = held;
  if (!held.is_bottle) {
    svgOf("ellipse", { class: "bottle", rx: r, ry: h }, parent);
    return;
  }
  svgOf("rect", { class: "cap", x: -r * 0.42, y: -h - 16, width: r * 0.84, height: 14, rx: 3 }, parent);
  const neck = r * 0.5;
  svgOf("path", { class: "bottle", d: `M${-neck} ${-h - 4}H${neck}Q${neck} ${-h + 16} ${r} ${-h + 34}V${h}q0 10 -10 10H${10 - r}q-10 0 -10 -10V${-h + 34}Q${-neck} ${-h + 16} ${-neck} ${-h - 4}z` }, parent);
}

/** Builds the picture of an object in a hand; returns draw(view, scene). */
function stageOf(svg, held, degrees) {
  svg.replaceChildren();
  const turned = svgOf("g", { transform: `rotate(${degrees})` }, svg);
  const thing = svgOf("g", {}, turned);
  drawObject(thing, held);
  const pads = [-1, 1].map((side) => {
    const group = svgOf("g", {}, turned);
    const x = side < 0 ? -PAD_MM : 0;
    const tall = side < 0 ? 48 : 88;
    const arms = side < 0 ? [0] : [-22, 22];
    for (const z of arms) svgOf("rect", { class: "arm", x: side < 0 ? -400 : PAD_MM - 4, y: z - 13, width: 404 - PAD_MM, height: 26, rx: 9 }, group);
    const pad = svgOf("rect", { class: "pad", x, y: -tall / 2, width: PAD_MM, height: tall, rx: 7 }, group);
    const arrow = svgOf("path", { class: "arrow" }, group);
    return { side, group, pad, arrow, below: tall / 2 + 14 };
  });
  const [giver, taker] = [1, -1].map((way) => svgOf("path", { class: "person", d: personPath(way, held) }, turned));
  const rope = svgOf("path", { class: "rope" }, svg);
  const hold = svgOf("circle", { class: "hold", r: 8 }, svg);
  const label = svgOf("text", { "text-anchor": "middle" }, svg);

  return function draw(view, alarm) {
    const [x, , z] = view.position.map((m) => 1e3 * m);
    thing.setAttribute("transform", `translate(${x} ${-z})`);
    for (const one of pads) {
      one.group.setAttribute("transform", `translate(${one.side * (held.radius_mm + 1e3 * view.gap)} 0)`);
      one.pad.setAttribute("class", alarm ? "pad alarm" : "pad");
      one.arrow.setAttribute("d", gripArrow(one.side, one.below, view.grip));
    }
    giver.style.opacity = view.supports;
    taker.style.opacity = view.takes;
    for (const person of [giver, taker]) person.setAttribute("transform", `translate(${x} ${-z})`);
    drawPull(rope, hold, label, toPage([x, z], degrees), toPage([view.pull[0], view.pull[2]], degrees));
  };
}

/** A hand below (1) or above (-1) an object. */
function personPath(way, held) {
  const edge = way * (held.half_tall_mm + (held.is_bottle ? 16 : 6)) + (way < 0 && held.is_bottle ? -8 : 0);
  const half = held.radius_mm * 0.8;
  return `M${-half} ${edge - way * 14}V${edge}H${half}V${edge - way * 14}M0 ${edge}V${edge + way * 40}`;
}

/** An arrow on a pad's outside that points inwards, longer with the grip. */
function gripArrow(side, y, gripN) {
  const long = Math.min(110, 12 + ARROW_MM_PER_N * gripN);
  const [tip, base] = [side * 2, side * 16];
  return gripN < 0.05 ? "" : `M${tip} ${y}L${base} ${y - 11}V${y - 5}H${side * (long + 4)}V${y + 5}H${base}V${y + 11}z`;
}

/** The pull: a line from the object, as long as the force, and its N. */
function drawPull(rope, hold, label, from, force) {
  const newtons = Math.hypot(...force);
  const shown = newtons > 0.2;
  for (const one of [rope, hold, label]) one.style.display = shown ? "" : "none";
  if (!shown) return;
  const to = from.map((place, k) => place + 4 * force[k]);
  rope.setAttribute("d", `M${from}L${to}`);
  hold.setAttribute("cx", to[0]);
  hold.setAttribute("cy", to[1]);
  label.textContent = `${newtons.toFixed(1)} N`;
  label.setAttribute("x", Math.max(-145, Math.min(145, to[0])));
  label.setAttribute("y", Math.max(-145, Math.min(155, to[1] + (force[1] < 0 ? -14 : 24))));
}

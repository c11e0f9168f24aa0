// The last two seconds: the answer at each sample as a strip, load and grip below it, and when a slip was called.
"use strict";

const LINES = { load: "#7a4fb5", grip: "#0b69a3" };
const DARK_LINES = { load: "#b79aec", grip: "#5fb0e5" };
const SHOWN_S = 2;
const [LEFT, STRIP, TOP] = [54, 18, 44];
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const linesNow = () => (dark.matches ? DARK_LINES : LINES);

/** rows: [{t, situation, load, grip, called}], the last is now. */
function drawStrip(canvas, rows) {
  const pen = penOf(canvas);
  const [wide, bottom] = [canvas.clientWidth, canvas.clientHeight - 22];
  const now = rows.length ? rows.at(-1).t : 0;
  const x = (t) => LEFT + ((t - now + SHOWN_S) / SHOWN_S) * (wide - LEFT - 4);
  const most = Math.max(10, ...rows.map((one) => 1.1 * Math.max(one.grip, one.load)));
  const y = (n) => bottom - (n / most) * (bottom - TOP);
  const ink = getComputedStyle(document.body).color;
  drawAxes(pen, ink, x, y, now, most);
  for (const one of rows) {
    pen.fillStyle = COLOURS[one.situation];
    pen.fillRect(x(one.t), STRIP, x(one.t + 1 / 150) - x(one.t) + 0.6, 18);
  }
  for (const [name, colour] of Object.entries(linesNow())) {
    pen.strokeStyle = colour;
    pen.lineWidth = 2;
    pen.beginPath();
    rows.forEach((one, k) => pen[k ? "lineTo" : "moveTo"](x(one.t), y(one[name])));
    pen.stroke();
  }
  drawCalls(pen, rows, x, bottom);
}

function drawAxes(pen, ink, x, y, now, most) {
  pen.fillStyle = ink;
  pen.strokeStyle = ink;
  pen.textAlign = "right";
  pen.fillText("answer", LEFT - 6, STRIP + 13);
  const step = [2, 5, 10, 20].find((n) => most / n <= 4) ?? 50;
  for (let n = 0; n <= most; n += step) {
    pen.fillText(`${n} N`, LEFT - 6, y(n) + 4);
    pen.globalAlpha = 0.2;
    pen.fillRect(LEFT, y(n), x(now) - LEFT, 1);
    pen.globalAlpha = 1;
  }
  pen.textAlign = "center";
  for (let s = 0.5; s < SHOWN_S; s += 0.5) pen.fillText(`${s} s ago`, x(now - s), y(0) + 18);
}

function drawCalls(pen, rows, x, bottom) {
  pen.fillStyle = dark.matches ? "#ff8f5c" : "#b3400b";
  pen.textAlign = "center";
  let free = LEFT + 16;  // no label over another
  rows.forEach((one, k) => {
    if (!one.called || rows[k - 1]?.called) return;
    pen.fillRect(x(one.t) - 1, STRIP - 4, 2, bottom - STRIP + 4);
    if (x(one.t) < free) return;
    pen.fillText("slip!", Math.min(x(one.t), x(rows.at(-1).t) - 12), STRIP - 6);
    free = x(one.t) + 34;
  });
}

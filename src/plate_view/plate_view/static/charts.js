// Curves of the last minute.

import { on } from "./bus.js";
import { byId, colour, fitted, seldom } from "./dom.js";

const LONG_S = 60;
const REDRAW_MS = 250;
const LEFT = 34;
const RIGHT = 74;
const FOOT = 14;

export class Chart {
  /** `curves`: [[name, colour variable, dash], ...]; `least`: minimum of a logarithmic axis, 0: linear axis from zero */
  constructor(id, unit, curves, least = 0) {
    Object.assign(this, { canvas: byId(id), unit, curves, least, points: [] });
    this.later = seldom(REDRAW_MS, () => this.draw());
    new ResizeObserver(() => this.later()).observe(this.canvas);
  }

  add(values) {
    const now = performance.now() / 1000;
    this.points.push([now, ...values]);
    while (this.points[0][0] < now - LONG_S) this.points.shift();
    this.later();
  }

  draw() {
    if (document.hidden) return;
    const { context, width, height } = fitted(this.canvas);
    const now = performance.now() / 1000;
    const values = this.points.flatMap((point) => point.slice(1)).filter(Number.isFinite);
    const { ticks, share } = this.least ? logAxis(values, this.least) : linearAxis(values);
    const x = (time) => LEFT + ((width - LEFT - RIGHT) * (time - now + LONG_S)) / LONG_S;
    const y = (value) => height - FOOT - (height - FOOT - 8) * share(value);
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.lineWidth = 1;
    for (const mark of ticks) {
      context.beginPath();
      context.moveTo(LEFT, y(mark));
      context.lineTo(width - RIGHT, y(mark));
      context.strokeStyle = colour("--rule");
      context.stroke();
      context.fillStyle = colour("--soft");
      context.textAlign = "right";
      context.fillText(mark < 1000 ? String(Number(mark.toPrecision(3))) : `${mark / 1000}k`, LEFT - 5, y(mark));
    }
    context.textAlign = "left";
    context.fillText("\u221260 s", LEFT, height - 5);
    context.textAlign = "right";
    context.fillText("now", width - RIGHT, height - 5);
    if (!values.length) {
      context.textAlign = "center";
      context.fillText("no data yet", (LEFT + width - RIGHT) / 2, height / 2 - 12);
      return;
    }
    const labels = [];
    this.curves.forEach(([name, ink, dash], k) => {
      context.beginPath();
      let last = null;
      for (const point of this.points) {
        const value = point[k + 1];
        if (!Number.isFinite(value)) continue;
        context.lineTo(x(point[0]), y(value));
        last = value;
      }
      context.strokeStyle = colour(ink);
      context.lineWidth = 1.75;
      context.setLineDash(dash);
      context.stroke();
      context.setLineDash([]);
      if (last !== null) labels.push({ words: `${name} ${Number(last.toPrecision(3))}`, at: y(last), ink });
    });
    labels.sort((a, b) => a.at - b.at);
    labels.forEach((label, i) => {
      if (i) label.at = Math.max(label.at, labels[i - 1].at + 13);
    });
    const over = (labels.at(-1)?.at ?? 0) - (height - FOOT + 2);
    context.textAlign = "left";
    for (const { words, at, ink } of labels) {
      context.fillStyle = colour(ink);
      context.fillText(words, width - RIGHT + 5, at - Math.max(0, over));
    }
    this.canvas.setAttribute("aria-label", `Last minute, ${this.unit}: ${labels.map(({ words }) => words).join(", ")}`);
  }
}

function linearAxis(values) {
  const most = Math.max(0, ...values);
  const power = 10 ** Math.floor(Math.log10(most || 1));
  const top = power * [1, 2, 4, 5, 10].find((step) => step * power >= most);
  return { ticks: [0, top / 2, top], share: (value) => value / top };
}

/** An axis of whole decades, from `least` [same unit]. */
function logAxis(values, least) {
  const decades = Math.max(2, Math.ceil(Math.log10(Math.max(least, ...values) / least)));
  const ticks = Array.from({ length: decades + 1 }, (_, i) => least * 10 ** i);
  return { ticks, share: (value) => Math.max(0, Math.log10(Math.max(value, least) / least)) / decades };
}

/** The two charts of the page. */
export function charts() {
  const errors = new Chart("errors", "mm", [["rms", "--curve-1", []], ["max", "--curve-2", [5, 3]], ["to go", "--curve-3", [2, 2]]], 0.1);
  const latency = new Chart("latency", "ms", [["median", "--curve-1", []], ["p99", "--curve-2", [5, 3]]]);
  on("task", ({ state, progress }) => {
    if (state !== "running" || !progress) return;
    const show = (metres) => (metres ? 1000 * metres : NaN); // 0: not defined for this task
    errors.add([show(progress.rms_error_m), show(progress.max_error_m), show(progress.to_go_m)]);
  });
  on("timing", ({ latency_ms: ms }) => latency.add([ms?.median ?? NaN, ms?.p99 ?? NaN]));
  return () => {
    errors.draw();
    latency.draw();
  };
}

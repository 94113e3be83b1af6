// The running cycle in slow motion: the enlarged motion of the plate's outline, and its rotation
// centres.

import { known, on } from "./bus.js";
import { byId, colour, fitted, setText } from "./dom.js";

const SHOWN_S = 3; // duration of one cycle on the screen
const FRAME_MS = 50;
const STRETCH = 0.12; // amplitude of the plate's motion on the screen, as a fraction of its length
const SENSE = { 1: "--ccw", [-1]: "--cw" };

export class CycleView {
  constructor() {
    this.canvas = byId("cycle");
    this.began = 0;
    this.calm = window.matchMedia("(prefers-reduced-motion: reduce)");
    on("cycle", () => {
      if (!this.timer) this.timer = setInterval(() => this.#frame(), FRAME_MS);
    });
  }

  /** Draw one frame. A newer cycle is shown when this one has ended. */
  #frame() {
    if (document.hidden) return;
    const now = performance.now() / 1000;
    if (!this.cycle || now - this.began >= SHOWN_S) {
      if (this.cycle === known.cycle && this.heldStill) return;
      this.cycle = known.cycle;
      this.began = now;
    }
    this.heldStill = this.calm.matches || this.#amplitude() < 1e-6;
    this.#draw(this.heldStill ? 0 : (now - this.began) / SHOWN_S);
  }

  #amplitude() {
    return Math.max(0, ...this.cycle.pose.map(([x, y, turn]) => Math.hypot(x, y) + Math.abs(turn) * 0.3));
  }

  #draw(phase) {
    const { pose, period, centres = [] } = this.cycle;
    const rig = known.hello?.rig ?? { length: 0.6, width: 0.3 };
    const { context, width, height } = fitted(this.canvas);
    const scale = Math.min((0.8 * width) / rig.length, (0.72 * height) / rig.width);
    const times = Math.max(1, Math.min(99, Math.round((STRETCH * rig.length) / Math.max(1e-4, this.#amplitude()))));
    setText(byId("cycle-note"), `${(1000 * period).toFixed(0)} ms, ${Math.round(SHOWN_S / period)}\u00d7 slower, motion \u00d7${times}`);
    const at = (x, y) => [width / 2 + scale * x, height / 2 - scale * y];
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => [(a * rig.length) / 2, (b * rig.width) / 2]);
    const sheet = (x, y, turn) => {
      context.beginPath();
      for (const [cx, cy] of corners) {
        context.lineTo(...at(times * x + cx * Math.cos(times * turn) - cy * Math.sin(times * turn),
          times * y + cx * Math.sin(times * turn) + cy * Math.cos(times * turn)));
      }
      context.closePath();
    };
    context.setLineDash([3, 3]);
    context.strokeStyle = colour("--faint");
    sheet(0, 0, 0);
    context.stroke();
    context.setLineDash([]);
    context.beginPath();
    for (const [x, y] of pose) context.lineTo(...at(times * x, times * y));
    context.strokeStyle = colour("--accent");
    context.lineWidth = 1.5;
    context.stroke();
    const [x, y, turn] = between(pose, phase);
    sheet(x, y, turn);
    context.strokeStyle = colour("--ink");
    context.lineWidth = 1.75;
    context.stroke();
    context.beginPath();
    context.arc(...at(times * x, times * y), 3, 0, 2 * Math.PI);
    context.fillStyle = colour("--ink");
    context.fill();
    const few = centres.length <= 8;
    context.font = `${few ? 14 : 9}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [cx, cy, sense] of centres) {
      context.fillStyle = colour(SENSE[Math.sign(sense)] ?? "--ink");
      context.fillText(sense > 0 ? "\u21ba" : "\u21bb", ...at(cx, cy));
    }
  }
}

/** The pose at a phase of 0 to 1, interpolated between samples. */
function between(pose, phase) {
  const place = Math.min(Math.max(phase, 0), 1) * (pose.length - 1);
  const i = Math.min(Math.floor(place), pose.length - 2);
  if (i < 0) return pose[0] ?? [0, 0, 0];
  return pose[i].map((value, k) => value + (place - i) * (pose[i + 1][k] - value));
}

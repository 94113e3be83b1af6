// The camera's picture with the detector's measurements. The view is used to aim, focus and light
// the camera.

import { known, on } from "./bus.js";
import { Chart } from "./charts.js";
import { byId, colour, fitted, setText } from "./dom.js";

const FONT = "12px system-ui, sans-serif";
const EXPECTED = "#00b4ff"; // this colour is visible on pictures of any brightness and in every theme; its lines are dashed
const SEEN = "#ffb000";
const TAKEN = "#30e090";
const LEFT = "#ff6a5a";
const BOARD = "#ff70e0";
const HALO = "rgb(0 0 0 / 0.65)";

export class AimView {
  constructor() {
    this.canvas = byId("camera");
    this.picture = null;
    this.chart = new Chart("sharpness", "per px", [["now", "--curve-1", []], ["best", "--curve-3", [2, 2]]]);
    on("camera", (message) => this.#take(message));
    on("aim", (aim) => {
      this.chart.add([aim.sharpness ?? NaN, aim.best ?? NaN]);
      this.draw();
    });
    new ResizeObserver(() => this.draw()).observe(byId("plate-box"));
  }

  /** The detector's latest measurements, or undefined. */
  get known() {
    return known.aim;
  }

  /** Show a picture. Pictures that arrive while one is being decoded are skipped. */
  async #take({ jpeg, width, height }) {
    if (this.unpacking) return;
    this.unpacking = true;
    const picture = new Image();
    picture.src = `data:image/jpeg;base64,${jpeg}`;
    try {
      await picture.decode();
      Object.assign(this, { picture, width, height });
    } catch {
      this.picture = null; // not a valid picture
    }
    this.unpacking = false;
    this.draw();
  }

  draw() {
    if (this.planned || document.hidden || byId("stage").dataset.view !== "camera") return;
    this.planned = true;
    requestAnimationFrame(() => {
      this.planned = false;
      this.#paint();
      histogram(known.aim);
    });
  }

  #paint() {
    const { context, width, height } = fitted(this.canvas);
    const aim = known.aim ?? {};
    const [wide, high] = [this.width ?? aim.width, this.height ?? aim.height];
    if (!wide || !high) {
      context.fillStyle = colour("--soft");
      context.font = FONT;
      context.textAlign = "center";
      context.fillText("no picture yet", width / 2, height / 2);
      return;
    }
    const scale = Math.min(width / wide, height / high);
    const [left, top] = [(width - scale * wide) / 2, (height - scale * high) / 2];
    const at = ([x, y]) => [left + scale * (x + 0.5), top + scale * (y + 0.5)];
    if (this.picture) context.drawImage(this.picture, left, top, scale * wide, scale * high);
    const { expected = [], seen = [], things = [], lens } = aim;
    stroke(context, ring(expected.map(at)), EXPECTED, 2, [7, 5]);
    for (const point of seen) dot(context, at(point), 3, SEEN);
    for (const { id, x, y, radius, reason } of things) {
      const [px, py] = at([x, y]);
      const disc = new Path2D();
      disc.arc(px, py, Math.max(4, scale * radius), 0, 2 * Math.PI);
      stroke(context, disc, id ? TAKEN : LEFT, 2, id ? [] : [4, 3]);
      label(context, id || reason, px, py - Math.max(4, scale * radius) - 8, id ? TAKEN : LEFT);
    }
    for (const point of lens?.corners ?? []) dot(context, at(point), 2.5, BOARD);
    label(context, "dashed: the plate according to the rig file; dots: its detected edges", left + 6, top + 12, EXPECTED, "left");
    const taken = things.filter(({ id }) => id).length;
    this.canvas.setAttribute("aria-label", `The camera's picture: ${taken} parts detected, ${things.length - taken} other objects. The panel Camera lists the same values.`);
  }
}

function ring(points) {
  const path = new Path2D();
  points.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
  path.closePath();
  return path;
}

function stroke(context, path, ink, width, dash = []) {
  context.strokeStyle = HALO;
  context.lineWidth = width + 2;
  context.stroke(path);
  context.setLineDash(dash);
  context.strokeStyle = ink;
  context.lineWidth = width;
  context.stroke(path);
  context.setLineDash([]);
}

function dot(context, [x, y], radius, ink) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = ink;
  context.fill();
  context.lineWidth = 1;
  context.strokeStyle = HALO;
  context.stroke();
}

function label(context, words, x, y, ink, align = "center") {
  context.font = FONT;
  context.textAlign = align;
  context.textBaseline = "middle";
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = HALO;
  context.strokeText(words, x, y);
  context.fillStyle = ink;
  context.fillText(words, x, y);
}

/** Bars on a logarithmic scale, so that a few clipped pixels are visible; the end bars in red. */
function histogram(aim) {
  const { context, width, height } = fitted(byId("histogram"));
  const bins = aim?.histogram ?? [];
  const most = Math.max(1, ...bins);
  const foot = 13;
  const bar = width / Math.max(1, bins.length);
  bins.forEach((count, i) => {
    const clipped = (i === 0 && aim.black > 0) || (i === bins.length - 1 && aim.white > 0);
    const tall = ((height - foot) * Math.log1p(count)) / Math.log1p(most);
    context.fillStyle = colour(clipped ? "--bad" : "--curve-1");
    context.fillRect(i * bar, height - foot - tall, Math.max(1, bar - 1), tall);
  });
  context.fillStyle = colour("--soft");
  context.font = "11px system-ui, sans-serif";
  context.textBaseline = "bottom";
  ["0", "128", "255"].forEach((words, i) => {
    context.textAlign = ["left", "center", "right"][i];
    context.fillText(words, (i * width) / 2, height);
  });
  const share = (value) => `${(100 * value).toFixed(1)} %`;
  const note = aim ? `at 0: ${share(aim.black)}; at 255: ${share(aim.white)}` : "histogram of the plate";
  setText(byId("histogram-note"), note);
  byId("histogram").setAttribute("aria-label", `Histogram of the plate's grey levels; ${note}`);
}

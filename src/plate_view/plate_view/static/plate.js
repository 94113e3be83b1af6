// The plate from above. Its layers are drawn from the lowest to the highest, and only after new
// data.

import { known, on } from "./bus.js";
import { byId, fitted } from "./dom.js";
import * as marks from "./marks.js";
import { Trails } from "./trails.js";

const MIN_MS = 25; // minimum time between two drawings, except while the pointer is dragging
const MARGIN_M = 0.012;
const RECENT = 8; // number of the latest messages of parts that are kept for matching with an image
const TOGETHER_S = 0.5; // maximum age of an image that determines the drawn parts
const NO_RIG = { length: 0.6, width: 0.3, motors: [] };

/** The layers: [key, label, shown at start, title]. */
export const LAYERS = [
  ["image", "Image", true, "the camera's image, seen from above"],
  ["outline", "Outlines", true, "the places of the parts"],
  ["name", "Names", true, "the ids of the parts"],
  ["spread", "Spread \u00d710", true, "the uncertainty of the parts' positions, enlarged ten times"],
  ["trail", "Trails", true, "the recent paths of the parts"],
  ["target", "Targets", true, "the targets of the parts"],
  ["wanted", "Requested", false, "the planner's request for each part"],
  ["task", "Task", true, "regions, paths and places of the task"],
  ["drift", "Drift", false, "the drift of parts at rest in the running cycle"],
  ["force", "Mean force", false, "mean friction on parts at rest in the running cycle"],
  ["centre", "Centres", true, "the rotation centres of the running cycle"],
];

export class PlateView {
  /** `layersChanged()` is called when the visible layers change. */
  constructor(layersChanged) {
    this.canvas = byId("plate");
    this.shown = Object.fromEntries(LAYERS.map(([key, , shown]) => [key, shown]));
    this.layersChanged = layersChanged;
    this.trails = new Trails();
    this.still = document.createElement("canvas"); // plate and grid
    this.field = document.createElement("canvas"); // arrows of the running cycle
    this.bitmap = null;
    this.recent = []; // latest messages of parts
    this.ghosts = new Map(); // id -> {x, y, angle, refused}: requested, not confirmed
    this.chosen = new Set(); // ids
    this.drawn = null; // {points}: a path that is being drawn
    this.band = null; // {from, to}: a selection frame
    this.hold = null; // id of the part whose target shows a knob for rotation
    new ResizeObserver(() => this.#resize()).observe(byId("plate-box"));
    for (const kind of ["targets", "wanted", "paths"]) on(kind, () => this.draw());
    on("parts", (message) => {
      this.recent = [...this.recent.slice(1 - RECENT), message];
      this.trails.add(message);
      this.draw();
    });
    on("cycle", () => {
      this.#drawField();
      this.draw();
    });
    on("hello", () => {
      this.trails.clear();
      this.#resize();
    });
    this.#resize();
  }

  get rig() {
    return known.hello?.rig ?? NO_RIG;
  }

  get parts() {
    return known.parts?.parts ?? [];
  }

  /** The parts with the simulator's names, which can be moved by hand. */
  get lying() {
    return known.truth?.parts ?? this.parts;
  }

  part(id) {
    return this.parts.find((part) => part.id === id);
  }

  /** The confirmed target of a part, or undefined. */
  target(id) {
    return known.targets?.targets.find((target) => target.id === id);
  }

  /** The destination of a part: its requested target, else its confirmed one, else its place. */
  aim(id) {
    return this.ghosts.get(id) ?? this.target(id) ?? this.part(id);
  }

  /** The appearance of a type of part, or undefined. */
  type(name) {
    return known.hello?.types?.[name];
  }

  /** Distance from the centre of a part to its edge [m]. */
  reach(type) {
    return this.type(type)?.reach ?? 0.008;
  }

  toPixel(x, y) {
    return [this.left + this.scale * (x - this.area.x[0]), this.top + this.scale * (this.area.y[1] - y)];
  }

  toPlate(px, py) {
    return [this.area.x[0] + (px - this.left) / this.scale, this.area.y[1] - (py - this.top) / this.scale];
  }

  show(layer, shown) {
    this.shown[layer] = shown;
    this.#drawField();
    this.layersChanged();
    this.draw();
  }

  /** The parts to draw: the parts of the shown image, so that parts and image match; without an image, the newest parts. */
  #drawnParts() {
    const newest = known.parts;
    if (!newest || !this.shown.image || !this.bitmap || Math.abs(newest.stamp - this.stamp) > TOGETHER_S) return this.parts;
    const away = ({ stamp }) => Math.abs(stamp - this.stamp);
    return this.recent.reduce((best, each) => (away(each) <= away(best) ? each : best), newest).parts;
  }

  /** A new image of the plate [its stamp, Blob]. While an image is being decoded, the newest image waits. */
  async image(stamp, blob) {
    this.packed = { stamp, blob };
    if (this.unpacking) return;
    this.unpacking = true;
    while (this.packed && !document.hidden) {
      const next = this.packed;
      this.packed = null;
      try {
        const bitmap = await createImageBitmap(next.blob);
        this.bitmap?.close();
        this.bitmap = bitmap;
        this.stamp = next.stamp;
      } catch {
        this.bitmap = null; // not a valid picture: draw without it
      }
      this.draw();
    }
    this.unpacking = false;
  }

  forgetImage() {
    this.bitmap?.close();
    this.bitmap = null;
    this.draw();
  }

  /** Draw soon. If `now` is true, draw before the next frame. */
  draw(now = false) {
    this.hurry ||= now;
    if (this.planned || document.hidden) return;
    this.planned = true;
    requestAnimationFrame((time) => this.#frame(time));
  }

  #frame(time) {
    this.planned = false;
    if (!this.hurry && time - (this.drawnAt ?? 0) < MIN_MS) {
      this.draw();
      return;
    }
    this.hurry = false;
    this.drawnAt = time;
    this.#paint();
  }

  #resize() {
    const { length, width } = this.rig;
    const [halfX, halfY] = [length / 2 + MARGIN_M, width / 2 + MARGIN_M];
    this.area = { x: [-halfX, halfX], y: [-halfY, halfY] };
    const { width: w, height: h } = fitted(this.canvas);
    const [spanX, spanY] = [this.area.x[1] - this.area.x[0], this.area.y[1] - this.area.y[0]];
    this.scale = Math.min(w / spanX, h / spanY);
    this.left = (w - this.scale * spanX) / 2;
    this.top = (h - this.scale * spanY) / 2;
    this.#drawStill();
    this.#drawField();
    this.draw(true);
  }

  #layer(canvas) {
    canvas.width = this.canvas.width;
    canvas.height = this.canvas.height;
    const context = canvas.getContext("2d");
    const ratio = canvas.width / Math.max(1, this.canvas.clientWidth);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    return context;
  }

  #drawStill() {
    marks.plate(this.#layer(this.still), this, this.rig);
  }

  #drawField() {
    const { drift, force } = this.shown;
    const field = known.cycle?.field;
    this.fieldDrawn = Boolean(field) && (drift || force) && !document.hidden;
    if (!this.fieldDrawn) return;
    const context = this.#layer(this.field);
    if (drift && field.drift) marks.arrows(context, this, field, field.drift, marks.DRIFT, "mm/s", 1000);
    if (force && field.force) marks.arrows(context, this, field, field.force, marks.FORCE, "\u00b5 m g", 1);
  }

  #paint() {
    const { context } = fitted(this.canvas);
    const { shown } = this;
    const blit = (canvas) => context.drawImage(canvas, 0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    blit(this.still);
    const image = known.hello?.image;
    if (shown.image && this.bitmap && image) {
      const [left, top] = this.toPixel(image.x[0], image.y[1]);
      const [right, bottom] = this.toPixel(image.x[1], image.y[0]);
      context.drawImage(this.bitmap, left, top, right - left, bottom - top);
    }
    if (shown.task && known.paths) marks.task(context, this, known.paths);
    if (this.fieldDrawn) blit(this.field);
    if (shown.trail) this.trails.draw(context, this);
    const filled = !(shown.image && this.bitmap);
    const parts = this.#drawnParts();
    for (const part of parts) {
      if (shown.outline) marks.part(context, this, part, { filled, chosen: this.chosen.has(part.id) });
      if (shown.spread && part.sd) marks.spread(context, this, part, 10);
    }
    if (shown.wanted && known.wanted) for (const request of known.wanted.parts) marks.wanted(context, this, request);
    if (shown.target) {
      for (const target of known.targets?.targets ?? []) {
        marks.target(context, this, target, this.part(target.id), this.reach(this.part(target.id)?.type));
      }
    }
    if (shown.name) for (const part of parts) marks.name(context, this, part, this.reach(part.type));
    for (const [id, ghost] of this.ghosts) marks.ghost(context, this, ghost, this.part(id), this.reach(this.part(id)?.type));
    if (this.hold) marks.knob(context, this, this.knob());
    if (shown.centre && known.cycle) marks.centres(context, this, known.cycle.centres ?? []);
    if (this.drawn) marks.path(context, this, this.drawn.points, this.drawn.closed);
    if (this.band) marks.band(context, this, this.band);
  }

  /** The knob that rotates the held target: its place, and its centre [pixels]; null without one. */
  knob() {
    const aim = this.hold && this.part(this.hold)?.turns ? this.aim(this.hold) : null;
    if (!aim) return null;
    const [x, y] = this.toPixel(aim.x, aim.y);
    const far = Math.max(30, this.scale * this.reach(this.part(this.hold).type) + 18);
    const angle = aim.angle ?? 0;
    return { x: x + far * Math.cos(angle), y: y - far * Math.sin(angle), middle: [x, y] };
  }
}

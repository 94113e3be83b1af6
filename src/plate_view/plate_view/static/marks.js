// Drawing of all objects on the plate. The colours suit a light plate in every theme. Shapes show
// the same information as colours: targets are crosses, unconfirmed objects are dashed, and
// rotation centres have an arrow.

import { clamp, degrees, mm } from "./dom.js";

const INK = "#1b1d1f";
const SURFACE = "#dddcd2";
const RIM = "#6b6d6a";
const GRID = "rgb(0 0 0 / 0.10)";
const TARGET = "#0059a0";
const GHOST = "#b34700";
const REQUEST_COLOUR = "#8a2f6b";
export const DRIFT = "#6d3f92";
export const FORCE = "#3d525f";
const SENSE = { 1: "#a85a00", [-1]: "#0b5f96" };
const GRID_M = 0.05;
const FEW = 8; // maximum number of rotation centres that have an arrow each
const FONT = "system-ui, sans-serif";

function line(context, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.stroke();
  context.setLineDash([]);
}

function text(context, words, x, y, { colour = INK, size = 11, align = "left", weight = 400 } = {}) {
  context.font = `${weight} ${size}px ${FONT}`;
  context.textAlign = align;
  context.textBaseline = "middle";
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = "rgb(240 240 234 / 0.85)";
  context.strokeText(words, x, y);
  context.fillStyle = colour;
  context.fillText(words, x, y);
}

function polyline(context, view, points, closed) {
  context.beginPath();
  points.forEach(([x, y], i) => {
    const at = view.toPixel(x, y);
    if (i) context.lineTo(...at);
    else context.moveTo(...at);
  });
  if (closed) context.closePath();
}

/** The plate with a grid of 50 mm and the axes of plate_home. */
export function plate(context, view, { length, width }) {
  const [left, top] = view.toPixel(-length / 2, width / 2);
  const [right, bottom] = view.toPixel(length / 2, -width / 2);
  context.fillStyle = SURFACE;
  context.fillRect(left, top, right - left, bottom - top);
  context.beginPath();
  for (let x = GRID_M * Math.ceil(-length / 2 / GRID_M); x <= length / 2; x += GRID_M) {
    const [px] = view.toPixel(x, 0);
    context.moveTo(px, top);
    context.lineTo(px, bottom);
  }
  for (let y = GRID_M * Math.ceil(-width / 2 / GRID_M); y <= width / 2; y += GRID_M) {
    const [, py] = view.toPixel(0, y);
    context.moveTo(left, py);
    context.lineTo(right, py);
  }
  line(context, GRID, 1);
  const [ox, oy] = view.toPixel(0, 0);
  context.beginPath();
  context.moveTo(ox - 6, oy);
  context.lineTo(ox + 6, oy);
  context.moveTo(ox, oy - 6);
  context.lineTo(ox, oy + 6);
  line(context, RIM, 1);
  context.strokeStyle = RIM;
  context.lineWidth = 1.5;
  context.strokeRect(left, top, right - left, bottom - top);
  text(context, "grid 50 mm", right - 6, bottom - 9, { colour: "#4d504d", size: 10, align: "right" });
}

/** The outline of a type as a path in metres. */
function outline(type, reach) {
  const path = new Path2D();
  if (!type?.outline?.length) path.arc(0, 0, reach, 0, 2 * Math.PI);
  for (const ring of type?.outline?.length ? [type.outline, ...(type.holes ?? [])] : []) {
    ring.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
    path.closePath();
  }
  return path;
}

const outlines = new WeakMap();

function stamped(context, view, { x, y, angle }, type, reach, paint) {
  let path = type && outlines.get(type);
  if (!path) {
    path = outline(type, reach);
    if (type) outlines.set(type, path);
  }
  context.save();
  context.translate(...view.toPixel(x, y));
  context.rotate(-(angle ?? 0));
  context.scale(view.scale, -view.scale);
  paint(path, 1 / view.scale);
  context.restore();
}

/** A part: filled if there is no image below it; dashed if it was not seen in the last image. */
export function part(context, view, part, { filled, chosen }) {
  const type = view.type(part.type);
  stamped(context, view, part, type, view.reach(part.type), (path, pixel) => {
    if (filled) {
      context.fillStyle = type?.colour ?? "#8a8a8a";
      context.fill(path, "evenodd");
    }
    context.setLineDash(part.seen ? [] : [3 * pixel, 3 * pixel]);
    context.lineWidth = (filled ? 1 : 1.75) * pixel;
    context.strokeStyle = filled ? INK : (type?.colour ?? INK);
    context.stroke(path);
    context.setLineDash([]);
  });
  const [x, y] = view.toPixel(part.x, part.y);
  const reach = view.scale * view.reach(part.type);
  if (part.turns) {
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + reach * Math.cos(part.angle), y - reach * Math.sin(part.angle));
    line(context, "rgb(255 255 255 / 0.9)", 3);
    line(context, INK, 1.25);
  }
  if (chosen) {
    context.beginPath();
    context.arc(x, y, reach + 5, 0, 2 * Math.PI);
    line(context, "rgb(255 255 255 / 0.9)", 4);
    line(context, GHOST, 2);
  }
}

export function name(context, view, part, reach) {
  const [x, y] = view.toPixel(part.x, part.y);
  const off = 0.75 * view.scale * reach + 3;
  text(context, part.seen ? part.id : `${part.id} (not seen)`, x + off, y - off);
}

/** The ellipse of two standard deviations, enlarged `times`. */
export function spread(context, view, { x, y, sd }, times) {
  const [rx, ry] = [2 * times * sd[0] * view.scale, 2 * times * sd[1] * view.scale];
  if (!(rx > 0 && ry > 0)) return;
  context.beginPath();
  context.ellipse(...view.toPixel(x, y), rx, ry, 0, 0, 2 * Math.PI);
  line(context, INK, 1, [2, 2]);
}

function cross(context, x, y, size) {
  context.beginPath();
  context.moveTo(x - size, y);
  context.lineTo(x + size, y);
  context.moveTo(x, y - size);
  context.lineTo(x, y + size);
}

function aimed(context, view, target, part, reach, colour, dash) {
  const [x, y] = view.toPixel(target.x, target.y);
  const size = Math.max(6, view.scale * reach);
  if (part) {
    context.beginPath();
    context.moveTo(...view.toPixel(part.x, part.y));
    context.lineTo(x, y);
    line(context, colour, 1, [4, 3]);
  }
  const turned = part?.turns && Number.isFinite(target.angle);
  if (turned) {
    stamped(context, view, target, view.type(part.type), reach, (path, pixel) => {
      context.setLineDash(dash.map((each) => each * pixel));
      context.lineWidth = 2 * pixel;
      context.strokeStyle = colour;
      context.stroke(path);
    });
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + (size + 8) * Math.cos(target.angle), y - (size + 8) * Math.sin(target.angle));
    line(context, colour, 2);
  } else {
    context.beginPath();
    context.arc(x, y, size, 0, 2 * Math.PI);
    line(context, colour, 2, dash);
  }
  cross(context, x, y, turned ? 5 : size + 4);
  line(context, colour, 1.5);
  return [x, y, size];
}

/** A target that the planner has confirmed: solid. */
export function target(context, view, target, part, reach) {
  aimed(context, view, target, part, reach, TARGET, []);
}

/** A requested target that is not confirmed: dashed, with its distance. */
export function ghost(context, view, ghost, part, reach) {
  const [x, y, size] = aimed(context, view, ghost, part, reach, GHOST, [4, 3]);
  if (ghost.refused) {
    const words = `\u2715 refused: ${ghost.refused}`;
    context.font = `600 12px ${FONT}`;
    const half = context.measureText(words).width / 2 + 6;
    const middle = Math.max(half, Math.min(x, view.canvas.clientWidth - half));
    text(context, words, middle, y + size + 14, { colour: "#9c1c00", size: 12, align: "center", weight: 600 });
  } else if (part) {
    const far = Math.hypot(ghost.x - part.x, ghost.y - part.y);
    const turn = part.turns && Number.isFinite(ghost.angle) ? `, ${degrees(ghost.angle)}\u00b0` : "";
    text(context, `${mm(far)} mm${turn}`, x, y + size + 14, { colour: GHOST, size: 12, align: "center", weight: 600 });
  }
}

/** The knob that rotates a target. */
export function knob(context, view, knob) {
  if (!knob) return;
  context.beginPath();
  context.moveTo(...knob.middle);
  context.lineTo(knob.x, knob.y);
  line(context, GHOST, 1);
  context.beginPath();
  context.arc(knob.x, knob.y, 7, 0, 2 * Math.PI);
  context.fillStyle = "#ffffff";
  context.fill();
  line(context, GHOST, 2);
}

/** The planner's request for a part: the target interval, and the force. */
export function wanted(context, view, request) {
  const part = view.part(request.id);
  if (!part) return;
  const { x, y } = view.area;
  const inside = (interval, bounds, middle) =>
    interval
      ? [clamp(interval[0] ?? bounds[0], ...bounds), clamp(interval[1] ?? bounds[1], ...bounds)]
      : [middle - 0.006, middle + 0.006];
  if (request.x || request.y) {
    const [x0, x1] = inside(request.x, x, part.x);
    const [y0, y1] = inside(request.y, y, part.y);
    const [left, top] = view.toPixel(x0, y1);
    const [right, bottom] = view.toPixel(x1, y0);
    context.beginPath();
    context.rect(left - 2, top - 2, right - left + 4, bottom - top + 4);
    line(context, REQUEST_COLOUR, 1.25, [6, 2]);
  }
  if (request.force) arrow(context, ...view.toPixel(part.x, part.y), 40 * request.force[0], -40 * request.force[1], REQUEST_COLOUR, 2);
}

function arrow(context, x, y, dx, dy, colour, width) {
  const length = Math.hypot(dx, dy);
  if (length < 2) return;
  const [ux, uy] = [dx / length, dy / length];
  const head = Math.min(6, 0.5 * length);
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x + dx, y + dy);
  context.moveTo(x + dx - head * (ux + 0.5 * uy), y + dy - head * (uy - 0.5 * ux));
  context.lineTo(x + dx, y + dy);
  context.lineTo(x + dx - head * (ux - 0.5 * uy), y + dy - head * (uy + 0.5 * ux));
  line(context, colour, width);
}

/** A vector field on a grid. The longest arrow has the grid's spacing; its value is written beside it. */
export function arrows(context, view, { x, y }, vectors, colour, unit, factor) {
  const greatest = Math.max(1e-12, ...vectors.map(([u, v]) => Math.hypot(u, v)));
  const step = view.scale * Math.min(Math.abs((x[1] ?? 1) - x[0]), Math.abs((y[1] ?? 1) - y[0]));
  const size = (0.95 * step) / greatest;
  vectors.forEach(([u, v], i) => {
    const [px, py] = view.toPixel(x[i % x.length], y[Math.floor(i / x.length)]);
    arrow(context, px - (size * u) / 2, py + (size * v) / 2, size * u, -size * v, colour, 1.25);
  });
  const { length, width } = view.rig;
  const [left, bottom] = view.toPixel(-length / 2, -width / 2);
  const row = unit === "mm/s" ? 9 : 23;
  text(context, `longest arrow ${(factor * greatest).toPrecision(2)} ${unit}`, left + 6, bottom - row, { colour, size: 11, weight: 600 });
}

/** Rotation centres: a few with an arrow. If there are many, as for a moving centre, rings mark
 * counter-clockwise and crosses clockwise rotation. */
export function centres(context, view, all) {
  if (all.length <= FEW) {
    for (const each of all) centre(context, view, each);
    return;
  }
  for (const sense of [1, -1]) {
    context.beginPath();
    for (const [x, y] of all.filter((each) => Math.sign(each[2]) === sense)) {
      const [px, py] = view.toPixel(x, y);
      if (sense > 0) {
        context.moveTo(px + 3, py);
        context.arc(px, py, 3, 0, 2 * Math.PI);
      } else {
        context.moveTo(px - 3, py - 3);
        context.lineTo(px + 3, py + 3);
        context.moveTo(px - 3, py + 3);
        context.lineTo(px + 3, py - 3);
      }
    }
    line(context, SENSE[sense], 1.25);
  }
}

function centre(context, view, [x, y, sense]) {
  const edge = 10; // centres may be far from the plate
  const [px, py] = view.toPixel(x, y);
  const [cx, cy] = [clamp(px, edge, view.canvas.clientWidth - edge), clamp(py, edge, view.canvas.clientHeight - edge)];
  const colour = SENSE[Math.sign(sense)] ?? INK;
  const inside = cx === px && cy === py;
  context.beginPath();
  context.arc(cx, cy, 8, 0.3, 2 * Math.PI - 0.6);
  line(context, "rgb(255 255 255 / 0.9)", 4);
  line(context, colour, 2, inside ? [] : [2, 2]);
  const end = sense > 0 ? 0.3 : 2 * Math.PI - 0.6; // y points up: counter-clockwise is reversed on the canvas
  const [ex, ey] = [cx + 8 * Math.cos(end), cy + 8 * Math.sin(end)];
  const way = sense > 0 ? -1 : 1;
  const [tx, ty] = [-way * Math.sin(end), way * Math.cos(end)];
  context.beginPath();
  context.moveTo(ex + 5 * tx, ey + 5 * ty);
  context.lineTo(ex - 4 * ty, ey + 4 * tx);
  context.lineTo(ex + 4 * ty, ey - 4 * tx);
  context.fillStyle = colour;
  context.fill();
  context.beginPath();
  context.arc(cx, cy, 1.5, 0, 2 * Math.PI);
  context.fill();
}

/** Paths, regions and places of the running task. */
export function task(context, view, { paths = [], regions = [], places = [] }) {
  for (const { type, polygon } of regions) {
    if (!polygon.length) continue;
    polyline(context, view, polygon, true);
    context.fillStyle = "rgb(0 89 160 / 0.07)";
    context.fill();
    line(context, TARGET, 1.25, [8, 4]);
    const xs = polygon.map(([x]) => x);
    const [middle] = view.toPixel((Math.min(...xs) + Math.max(...xs)) / 2, 0);
    const [, top] = view.toPixel(0, Math.max(...polygon.map(([, y]) => y)));
    text(context, type, middle, top + 11, { colour: TARGET, size: 12, align: "center", weight: 600 });
  }
  for (const { points, closed } of paths) path(context, view, points, closed, TARGET);
  for (const place of places) {
    stamped(context, view, place, view.type(place.type), view.reach(place.type), (shape, pixel) => {
      context.setLineDash([4 * pixel, 3 * pixel]);
      context.lineWidth = 1.5 * pixel;
      context.strokeStyle = TARGET;
      context.stroke(shape);
    });
    const [x, y] = view.toPixel(place.x, place.y);
    cross(context, x, y, 4);
    line(context, TARGET, 1.25);
    text(context, place.type, x, y + view.scale * view.reach(place.type) + 8, { colour: TARGET, size: 10, align: "center" });
  }
}

export function path(context, view, points, closed, colour = GHOST) {
  if (points.length < 2) return;
  polyline(context, view, points, closed);
  line(context, colour, 2, colour === GHOST ? [6, 3] : []);
  const middle = Math.max(1, Math.floor(points.length / 2));
  const [x0, y0] = view.toPixel(...points[middle - 1]);
  const [x1, y1] = view.toPixel(...points[middle]);
  const far = Math.hypot(x1 - x0, y1 - y0) || 1;
  arrow(context, x1 - (12 * (x1 - x0)) / far, y1 - (12 * (y1 - y0)) / far, (12 * (x1 - x0)) / far, (12 * (y1 - y0)) / far, colour, 2);
}

/** A selection frame. */
export function band(context, view, { from, to }) {
  context.beginPath();
  context.rect(from[0], from[1], to[0] - from[0], to[1] - from[1]);
  context.fillStyle = "rgb(179 71 0 / 0.08)";
  context.fill();
  line(context, GHOST, 1.5, [5, 3]);
}

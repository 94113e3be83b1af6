// The paths of the parts in the last seconds.

const LONG_S = 10;
const STEP_M = 0.0012; // minimum distance between two points of a path
const COLOUR = "rgb(0 110 80 / 0.65)";

export class Trails {
  constructor() {
    this.clear();
  }

  clear() {
    this.points = new Map(); // id -> [x, y, stamp, ...]
    this.stamp = -Infinity;
  }

  add({ stamp, parts }) {
    if (stamp < this.stamp - 1e-6 || stamp > this.stamp + LONG_S) this.clear(); // restarted
    this.stamp = stamp;
    for (const { id, x, y } of parts) {
      const trail = this.points.get(id) ?? [];
      this.points.set(id, trail);
      const n = trail.length;
      if (!n || Math.hypot(x - trail[n - 3], y - trail[n - 2]) > STEP_M) trail.push(x, y, stamp);
    }
    for (const [id, trail] of this.points) {
      let old = 0;
      while (old < trail.length && trail[old + 2] < stamp - LONG_S) old += 3;
      if (old) trail.splice(0, old);
      if (!trail.length) this.points.delete(id);
    }
  }

  draw(context, view) {
    context.beginPath();
    for (const trail of this.points.values()) {
      for (let i = 0; i < trail.length; i += 3) {
        const [x, y] = view.toPixel(trail[i], trail[i + 1]);
        if (i) context.lineTo(x, y);
        else context.moveTo(x, y);
      }
    }
    context.strokeStyle = COLOUR;
    context.lineWidth = 1.5;
    context.stroke();
  }
}

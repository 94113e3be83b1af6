// The pointer on the plate: it drags targets, selects several parts, draws paths and moves
// simulated parts.

import { known, on } from "./bus.js";
import { byId, clamp, mm, seldom, setText } from "./dom.js";

const NEAR_PX = 12; // maximum distance from a part's edge at which the part is hit
const UNANSWERED = 3; // maximum number of moves without a reply
const STEP_M = 0.004; // distance between the points of a drawn path
const REFUSED_MS = 5000; // time for which a refusal is shown at its target
const BY_HAND = "by hand"; // used instead of a part's id, because the simulator uses other names
const REQUEST_MS = 2000; // time for which a request is shown if the confirmed target differs from it

const HINTS = {
  target: "Drag a part or a target. Shift-click selects several. The round knob rotates the target.",
  select: "Draw a frame around parts, then drag one of them: all move together.",
  path: "Draw a path: start on a part and keep the button pressed.",
  hand: "Simulator: drag a part to its new place.",
};

export class Drag {
  /** `execute(command, output)` sends a command and shows its reply in the output. */
  constructor(view, connection, execute) {
    Object.assign(this, { view, connection, execute, grip: null, due: new Set(), open: 0, mode: "target" });
    this.answer = byId("plate-answer");
    const { canvas } = view;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => this.#up(event));
    canvas.addEventListener("pointerleave", () => setText(byId("pointer"), ""));
    canvas.addEventListener("wheel", (event) => this.#turn(event), { passive: false });
    window.addEventListener("keydown", (event) => event.key === "Escape" && this.drop());
    for (const input of document.querySelectorAll("input[name=mode]")) {
      input.addEventListener("change", () => this.use(input.value));
    }
    byId("path-follow").addEventListener("click", () => this.#follow());
    byId("path-drop").addEventListener("click", () => this.drop());
    byId("path-closed").addEventListener("change", () => this.#closePath());
    this.checkSoon = seldom(REQUEST_MS + 50, () => this.#confirmed());
    on("targets", () => this.#confirmed());
    on("task", ({ state }) => state === "running" || this.#forget());
    on("hello", ({ simulator }) => (byId("mode-hand").hidden = !simulator));
    this.use("target");
  }

  use(mode) {
    this.mode = mode;
    this.drop();
    byId("path-form").hidden = mode !== "path";
    setText(byId("hint"), HINTS[mode]);
  }

  /** Clear the selection, the drawn path and the drag. */
  drop() {
    Object.assign(this.view, { drawn: null, band: null, hold: null });
    this.view.chosen.clear();
    this.grip = null;
    for (const id of ["path-follow", "path-drop"]) byId(id).disabled = true;
    this.view.draw(true);
  }

  /** Request targets for parts: [{id, x, y, angle}]; drawn as unconfirmed until the planner confirms. */
  send(targets) {
    for (const { id, x, y, angle } of targets) {
      this.view.ghosts.set(id, { x, y, angle: angle ?? null, refused: null, requestTime: performance.now() });
      this.due.add(id);
    }
    this.view.draw(true);
    this.#pump();
  }

  get allowed() {
    return !byId("modes").disabled;
  }

  #at(event) {
    const box = this.view.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** The part at the pointer, or whose target is there. */
  #hit([px, py], targetsToo, parts = this.view.parts) {
    let best = null;
    for (const part of parts) {
      const spots = [part];
      if (targetsToo && this.view.aim(part.id) !== part) spots.unshift(this.view.aim(part.id));
      for (const spot of spots) {
        const [x, y] = this.view.toPixel(spot.x, spot.y);
        const far = Math.hypot(px - x, py - y) - this.view.scale * this.view.reach(part.type);
        if (far < NEAR_PX && (!best || far < best.far)) best = { id: part.id, far, spot };
      }
    }
    return best;
  }

  #down(event) {
    if (event.button !== 0 || !this.allowed || this.grip) return;
    const at = this.#at(event);
    const grip = this.#grasp(at, event.shiftKey);
    if (!grip) return;
    this.grip = { ...grip, pointer: event.pointerId };
    this.view.canvas.setPointerCapture(event.pointerId);
    this.view.draw(true);
  }

  /** The thing that a press at this place would drag; null: nothing. */
  #grasp(at, shift) {
    const { view } = this;
    const knob = view.knob();
    if (knob && Math.hypot(at[0] - knob.x, at[1] - knob.y) < 16) return { kind: "turn", ids: [view.hold] };
    if (this.mode === "hand") {
      const hit = this.#hit(at, false, view.lying);
      const [x, y] = view.toPlate(...at);
      return hit && { kind: "hand", part: hit.spot, dx: hit.spot.x - x, dy: hit.spot.y - y };
    }
    const hit = this.#hit(at, this.mode !== "path");
    if (this.mode === "path") {
      if (!hit) return null;
      const part = view.part(hit.id);
      view.drawn = { id: hit.id, points: [[part.x, part.y]], closed: false };
      return { kind: "path", ids: [hit.id] };
    }
    if (hit && shift) {
      if (!view.chosen.delete(hit.id)) view.chosen.add(hit.id);
      return null;
    }
    if (hit && view.chosen.has(hit.id)) return this.#carry([...view.chosen], at, view.part(hit.id) !== hit.spot);
    if (this.mode === "select") {
      view.chosen = new Set(hit ? [hit.id] : []);
      if (hit) return this.#carry([hit.id], at);
      view.band = { from: at, to: at };
      return { kind: "band" };
    }
    view.chosen.clear();
    view.hold = hit?.id ?? null;
    return hit && this.#carry([hit.id], at, view.part(hit.id) !== hit.spot);
  }

  /** The parts that the pointer drags, from their targets or their places. */
  #carry(ids, at, fromTargets = false) {
    const [x, y] = this.view.toPlate(...at);
    const offsets = ids
      .map((id) => ({ part: this.view.part(id), from: fromTargets ? this.view.aim(id) : this.view.part(id), aim: this.view.aim(id) }))
      .filter(({ part }) => part)
      .map(({ part, from, aim }) => ({ id: part.id, dx: from.x - x, dy: from.y - y, angle: part.turns ? (aim.angle ?? null) : null }));
    return { kind: "target", ids, offsets };
  }

  #move(event) {
    const at = this.#at(event);
    const [x, y] = this.view.toPlate(...at);
    setText(byId("pointer"), `x ${mm(x)}  y ${mm(y)} mm`);
    const { grip, view } = this;
    if (!grip || grip.pointer !== event.pointerId) return;
    if (grip.kind === "band") view.band.to = at;
    else if (grip.kind === "path") this.#drawOn(event);
    else if (grip.kind === "turn") this.#turnTo(grip, x, y);
    else if (grip.kind === "hand") this.#place(grip, x, y);
    else this.#carryTo(grip, x, y);
    view.draw(true);
  }

  #carryTo(grip, x, y) {
    grip.moved = true;
    this.send(grip.offsets.map(({ id, dx, dy, angle }) => ({ id, ...this.#within(x + dx, y + dy, this.view.part(id)?.type), angle })));
  }

  /** A place for a part of this type, moved completely onto the plate. */
  #within(x, y, type) {
    const { length, width } = this.view.rig;
    const rim = this.view.reach(type);
    return { x: clamp(x, rim - length / 2, length / 2 - rim), y: clamp(y, rim - width / 2, width / 2 - rim) };
  }

  #drawOn(event) {
    const { points } = this.view.drawn;
    for (const each of event.getCoalescedEvents?.() ?? [event]) {
      const { length, width } = this.view.rig;
      let [x, y] = this.view.toPlate(...this.#at(each));
      [x, y] = [clamp(x, -length / 2, length / 2), clamp(y, -width / 2, width / 2)];
      const last = points[points.length - 1];
      if (Math.hypot(x - last[0], y - last[1]) > STEP_M) points.push([x, y]);
    }
  }

  #turnTo(grip, x, y) {
    const [id] = grip.ids;
    grip.moved = true;
    const aim = this.view.aim(id);
    this.send([{ id, x: aim.x, y: aim.y, angle: Math.atan2(y - aim.y, x - aim.x) }]);
  }

  #turn(event) {
    const id = this.view.hold;
    if (!id || !this.allowed || !this.view.part(id)?.turns) return;
    event.preventDefault();
    const aim = this.view.aim(id);
    this.send([{ id, x: aim.x, y: aim.y, angle: (aim.angle ?? 0) - (Math.sign(event.deltaY) * Math.PI) / 36 }]);
  }

  #up(event) {
    const { grip, view } = this;
    if (!grip || grip.pointer !== event.pointerId) return;
    this.grip = null;
    if (grip.kind === "band") {
      const [[x0, y0], [x1, y1]] = [view.band.from, view.band.to];
      for (const part of view.parts) {
        const [x, y] = view.toPixel(part.x, part.y);
        if ((x - x0) * (x - x1) <= 0 && (y - y0) * (y - y1) <= 0) view.chosen.add(part.id);
      }
      view.band = null;
    } else if (grip.kind === "path") {
      const drawn = view.drawn.points.length > 2;
      if (!drawn) view.drawn = null;
      for (const id of ["path-follow", "path-drop"]) byId(id).disabled = !drawn;
      this.#closePath();
    } else if (grip.kind === "hand") {
      view.ghosts.delete(BY_HAND);
    }
    if (grip.moved) this.#rest(grip.ids);
    this.#confirmed();
    view.draw(true);
  }

  /** Send the final targets at the end of a drag. */
  #rest(ids) {
    for (const id of ids) if (this.view.ghosts.has(id)) this.due.add(id);
    this.#pump();
  }

  #closePath() {
    if (this.view.drawn) this.view.drawn.closed = byId("path-closed").checked;
    this.view.draw(true);
  }

  #follow() {
    const { id, points, closed } = this.view.drawn;
    const speed = byId("path-speed").valueAsNumber / 1000;
    this.execute({ do: "follow", id, points, speed, closed }, this.answer).then(({ ok }) => ok && this.drop());
  }

  /** In the simulator: place a part at the pointer, once per frame. */
  #place({ part, dx, dy }, x, y) {
    const spot = this.#within(x + dx, y + dy, part.type);
    this.hand = { do: "place", id: part.id, type: part.type, ...spot, angle: part.angle ?? 0 };
    this.view.ghosts.set(BY_HAND, { ...spot, angle: null, refused: null, requestTime: performance.now() });
    this.#pump();
  }

  /** Send due commands at most once per frame, and only as fast as the connection takes them. */
  #pump() {
    if (this.planned) return;
    this.planned = true;
    requestAnimationFrame(() => {
      this.planned = false;
      const more = this.due.size || this.hand;
      if (!more) return;
      if (this.connection.full || this.open >= UNANSWERED) {
        this.#pump();
        return;
      }
      if (this.due.size) this.#sendMove();
      if (this.hand) this.#sendHand();
    });
  }

  #sendMove() {
    const ids = [...this.due];
    this.due.clear();
    const targets = ids.filter((id) => this.view.ghosts.has(id)).map((id) => {
      const { x, y, angle } = this.view.ghosts.get(id);
      return { id, x, y, angle };
    });
    const held = this.grip?.ids ?? [];
    const dragging = ids.some((id) => held.includes(id));
    if (targets.length) this.#count({ do: "move", targets, dragging }, (answer) => this.#moved(ids, answer));
  }

  #sendHand() {
    const command = this.hand;
    this.hand = null;
    this.#count(command, () => {});
  }

  #count(command, then) {
    this.open += 1;
    this.execute(command, this.answer, true).then((answer) => {
      this.open -= 1;
      then(answer);
    });
  }

  #moved(ids, { ok, text }) {
    this.checkSoon();
    if (ok) return;
    for (const id of ids) {
      const ghost = this.view.ghosts.get(id);
      if (!ghost) continue;
      ghost.refused = text || "no reason given";
      setTimeout(() => {
        if (this.view.ghosts.get(id) === ghost) this.view.ghosts.delete(id);
        this.view.draw();
      }, REFUSED_MS);
    }
    this.view.draw();
  }

  /** No task runs: discard older unconfirmed requests. */
  #forget() {
    for (const [id, { requestTime, refused }] of this.view.ghosts) {
      if (!refused && !this.grip?.ids?.includes(id) && performance.now() - requestTime > REQUEST_MS) this.view.ghosts.delete(id);
    }
    this.view.draw();
  }

  /** Remove requests that the planner has confirmed. */
  #confirmed() {
    const held = new Set(this.grip?.ids ?? []);
    for (const { id, x, y, angle } of known.targets?.targets ?? []) {
      const ghost = this.view.ghosts.get(id);
      if (!ghost || held.has(id) || this.due.has(id) || ghost.refused) continue;
      const turned = ghost.angle === null || angle === null || Math.cos(ghost.angle - angle) > 0.9998;
      const old = performance.now() - ghost.requestTime > REQUEST_MS;
      if (old || (Math.hypot(ghost.x - x, ghost.y - y) < 5e-4 && turned)) this.view.ghosts.delete(id);
    }
    this.view.draw();
  }
}

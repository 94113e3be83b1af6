// The simulator panel: place and remove parts, reset, set the rate of time and the disturbances.

import { known, on } from "../bus.js";
import { el } from "../dom.js";
import { parameterBox } from "./parameters.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

export function simulator(panel, execute, view) {
  const answer = el("output", { className: "answer" });
  const type = el("select", { id: "add-type" });
  const field = (id, value, more = {}) => el("input", { id, type: "number", value, step: "any", ...more });
  const [x, y, angle] = [field("add-x", 0), field("add-y", 0), field("add-angle", 0)];
  const part = el("select", { id: "remove-part" });
  const seed = field("reset-seed", "", { step: 1, min: 0, placeholder: "same" });
  const button = (words, work) => {
    const node = el("button", { type: "button" }, words);
    node.addEventListener("click", work);
    return node;
  };
  const number = (input) => input.valueAsNumber || 0;
  const rates = SPEEDS.map((rate) => button(`\u00d7${rate}`, () => execute({ do: "set", node: "simulator", name: "rate", value: rate }, answer)));
  const labelled = (words, input) => el("label", { htmlFor: input.id }, `${words} `, input);
  const controls = el("fieldset", { className: "controls stack" }, el("legend", {}, "Parts and time"),
    el("div", { className: "row" }, labelled("Type", type), labelled("x mm", x), labelled("y mm", y), labelled("angle \u00b0", angle),
      button("Add", () => execute({ do: "place", id: null, type: type.value, x: number(x) / 1000, y: number(y) / 1000, angle: (number(angle) * Math.PI) / 180 }, answer))),
    el("div", { className: "row" }, labelled("Part", part), button("Remove", () => execute({ do: "remove", id: simulated(view, part.value) }, answer))),
    el("div", { className: "row" }, labelled("Seed", seed), button("Reset", () => execute({ do: "reset", seed: seed.value === "" ? null : number(seed) }, answer).then(({ ok }) => ok && view.trails.clear()))),
    el("div", { className: "row" }, "Time ", ...rates),
    el("p", { className: "small" }, "Rates other than \u00d71 require simulated time: make play ARGS=--simulated-time"), answer);
  panel.append(el("h2", {}, "Simulator"), el("p", { className: "small" }, "\u201cMove by hand\u201d over the plate lets you drag parts."), controls,
    parameterBox("simulator", execute, ({ name }) => name !== "scenario"));
  on("hello", ({ types }) => type.replaceChildren(...Object.keys(types).map((name) => el("option", {}, name))));
  let listed = "";
  const list = () => {
    const ids = view.parts.map(({ id }) => id);
    if (panel.hidden || ids.join() === listed) return;
    listed = ids.join();
    const chosen = part.value;
    part.replaceChildren(...ids.map((id) => el("option", {}, id)));
    if (ids.includes(chosen)) part.value = chosen;
  };
  on("parts", list);
  return () => {
    list();
    if (known.hello) execute({ do: "parameters", node: "simulator" }, answer, true);
  };
}

/** The simulator's name of a part that the detector has named: the name of the nearest true part. */
function simulated(view, id) {
  const seen = view.part(id);
  const away = ({ x, y }) => Math.hypot(x - seen.x, y - seen.y);
  const near = seen && view.lying.toSorted((a, b) => away(a) - away(b))[0];
  return near ? near.id : id;
}

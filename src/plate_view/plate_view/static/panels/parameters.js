// Controls for the parameters of a node. The controls are made from the node's descriptions.

import { known, on } from "../bus.js";
import { el } from "../dom.js";

const WIDEST = 1000; // maximum range with a slider
const NODES = ["solver", "planner", "driver", "detector"];

/** A control for one parameter; `set(value)` returns a promise of the reply. */
function control(node, parameter, execute) {
  const { name, value, description, low, high, choices, live } = parameter;
  const id = `${node}.${name}`;
  const answer = el("output", { className: "answer" });
  const bounded = typeof value === "number" && Number.isFinite(low) && Number.isFinite(high);
  const slid = bounded && live !== false && high - low <= WIDEST;
  let input;
  if (choices?.length) input = el("select", {}, ...choices.map((choice) => el("option", {}, String(choice))));
  else if (typeof value === "boolean") input = el("input", { type: "checkbox" });
  else if (typeof value === "number") input = el("input", { type: "number", step: "any" });
  else input = el("input", { type: "text" });
  input.id = id;
  input.disabled = live === false;
  if (bounded) Object.assign(input, { min: low, max: high });
  const slider = slid ? el("input", { type: "range", min: low, max: high, step: step(low, high, value), "aria-label": `${name}, slider` }) : null;
  const show = (to) => {
    if (document.activeElement !== input) input[input.type === "checkbox" ? "checked" : "value"] = input.type === "checkbox" ? Boolean(to) : Array.isArray(to) ? to.join(", ") : to;
    if (slider && document.activeElement !== slider) slider.value = to;
  };
  show(value);
  let last = value;
  const set = async (to) => {
    const { ok } = await execute({ do: "set", node, name, value: to }, answer);
    if (ok) last = to;
    else {
      input[input.type === "checkbox" ? "checked" : "value"] = last;
      if (slider) slider.value = last;
    }
  };
  input.addEventListener("change", () => {
    const to = input.type === "checkbox" ? input.checked : typeof value === "number" ? input.valueAsNumber || 0 : input.value;
    if (slider) slider.value = to;
    set(to);
  });
  slider?.addEventListener("input", () => (input.value = slider.value));
  slider?.addEventListener("change", () => set(slider.valueAsNumber));
  const row = el("div", { className: "parameter" }, el("label", { htmlFor: id, title: description ?? "" }, name), input);
  if (slider) row.append(slider);
  row.append(el("p", { className: "small" }, description ?? "", live === false ? " (at start only)" : ""), answer);
  return { row, show: (to) => show((last = to)) };
}

function step(low, high, value) {
  const whole = [low, high, value].every(Number.isInteger) && high - low > 1;
  return whole ? 1 : (high - low) / 200;
}

/** Parameters that are rarely changed while the graph runs. */
const rare = ({ name, value, choices, live }) => live === false || name === "use_sim_time" || (typeof value === "string" && !choices?.length);

/** The controls of a node in a box: created once, then updated. */
export function parameterBox(node, execute, keep = () => true) {
  const box = el("fieldset", { className: "controls parameters" }, el("legend", {}, `Parameters of the ${node}`), el("p", { className: "empty" }, "not received yet"));
  const more = el("details", {}, el("summary", {}, "Names, files and parameters that are read only at start"));
  let rows = new Map();
  on("parameters", (message) => {
    if (message.node.replace(/^.*\//, "") !== node) return;
    const shown = message.parameters.filter(keep);
    if (shown.some(({ name }) => !rows.has(name))) {
      rows = new Map(shown.map((parameter) => [parameter.name, control(node, parameter, execute)]));
      box.querySelector(".empty")?.remove();
      for (const old of box.querySelectorAll(".parameter")) old.remove();
      for (const parameter of shown) (rare(parameter) ? more : box).append(rows.get(parameter.name).row);
      if (shown.some(rare)) box.append(more);
    } else {
      for (const { name, value } of shown) rows.get(name).show(value);
    }
  });
  return box;
}

/** The panel: one node at a time. */
export function parameters(panel, execute) {
  const choose = el("select", { id: "node" }, ...NODES.map((node) => el("option", {}, node)));
  const boxes = NODES.map((node) => parameterBox(node, execute));
  const answer = el("output", { className: "answer" });
  const show = () => {
    boxes.forEach((box, i) => (box.hidden = NODES[i] !== choose.value));
    if (!panel.hidden && known.hello) execute({ do: "parameters", node: choose.value }, answer, true);
  };
  choose.addEventListener("change", show);
  on("hello", () => panel.hidden || show());
  const look = el("select", { id: "theme" }, ...[["", "as the system"], ["light", "light"], ["dark", "dark"]].map(([value, words]) => el("option", { value }, words)));
  panel.append(el("h2", {}, "Settings"), el("p", {}, el("label", { htmlFor: "theme" }, "Theme "), look), el("p", {}, el("label", { htmlFor: "node" }, "Node "), choose), answer, ...boxes);
  show();
  return show;
}

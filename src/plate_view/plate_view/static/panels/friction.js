// The friction panel: it measures the friction of the parts by small pushes of the plate, and
// writes it into the rig file.

import { on } from "../bus.js";
import { el, setText } from "../dom.js";

export function friction(panel, execute) {
  const answer = el("output", { className: "answer" });
  const button = (words, command, className = "") => {
    const node = el("button", { type: "button", className }, words);
    node.addEventListener("click", () => execute(command, answer));
    return node;
  };
  const measure = button("Measure friction", { do: "measure_friction", start: true });
  const end = button("End", { do: "measure_friction", start: false });
  const write = button("Write", { do: "write_friction" }, "main");
  const done = el("progress", { max: 1, value: 0, "aria-label": "Progress of the friction measurement" });
  const text = el("p", { className: "small", id: "friction-text" });
  const list = el("ul", { className: "small", id: "friction-parts" });
  panel.append(el("fieldset", { className: "controls stack" }, el("legend", {}, "Friction"),
    el("p", { className: "small" }, "The plate makes about 40 small pushes in a minute. Parts move by a few millimetres and return. Put the parts away from each other and from the edges, and run no task."),
    el("div", { className: "row" }, measure, end, write), done, answer, text, list));
  const show = ({ state, text: words, fraction, mu, parts }) => {
    measure.hidden = state === "running";
    [end.hidden, done.hidden] = [state !== "running", state !== "running"];
    write.hidden = state !== "done";
    done.value = fraction;
    setText(text, words);
    text.toggleAttribute("data-bad", state === "failed");
    if (state === "done") setText(write, `Write mu ${mu.toFixed(3)} to the rig file`);
    list.replaceChildren(...parts.map((one) => el("li", {}, `${one.id}: ${one.mu.toFixed(4)} \u00b1 ${one.error.toFixed(4)}`)));
  };
  on("friction", show);
  show({ state: "none", text: "", fraction: 0, mu: 0, parts: [] });
}

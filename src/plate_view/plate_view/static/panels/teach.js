// Teach: a new type of part from the live image, and the plate itself.

import { el } from "../dom.js";

export function teach(panel, ask) {
  const answers = [el("output", { className: "answer" }), el("output", { className: "answer" })];
  const name = el("input", { id: "teach-name", type: "text", maxLength: 40, autocomplete: "off", spellcheck: false, required: true });
  const plate = el("button", { type: "button" }, "Learn the empty plate");
  const part = el("button", { type: "submit" }, "Teach this part");
  const form = el("form", { className: "row" }, el("label", { htmlFor: "teach-name" }, "Name ", name), part);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    ask({ do: "teach", name: name.value.trim() }, answers[1]);
  });
  plate.addEventListener("click", () => ask({ do: "learn_plate" }, answers[0]));
  panel.append(el("h2", {}, "Teach"),
    el("fieldset", { className: "controls stack" }, el("legend", {}, "1. The plate"),
      el("p", {}, "Take everything off the plate, and let the light be as it will be."), plate, answers[0]),
    el("fieldset", { className: "controls stack" }, el("legend", {}, "2. A part"),
      el("p", {}, "Lay one part of the new type on the plate, away from the rim, and give the type a name."), form, answers[1]));
}

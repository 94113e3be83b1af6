// The emergency stop. The command is sent at once, and the button shows whether it is confirmed.

import { byId } from "./dom.js";
import { on } from "./bus.js";

const ANSWER_MS = 1000;
const TYPED = new Set(["text", "number", "search", "email", "url", "password", "tel"]);
const CUT = "Cut the power by hand.";

/** Whether a key pressed in this element is for the element, not for the page. */
function takesSpace(node) {
  if (node.isContentEditable || /^(TEXTAREA|SELECT|BUTTON|SUMMARY)$/.test(node.tagName)) return true;
  return node.tagName === "INPUT" && (TYPED.has(node.type) || /^(checkbox|radio|button|submit)$/.test(node.type));
}

export class EmergencyStop {
  /** `alarm(text | null)` shows a warning over the plate. */
  constructor(connection, alarm) {
    Object.assign(this, { connection, alarm, pending: null });
    this.button = byId("emergency-stop");
    this.note = this.button.querySelector("small");
    this.usual = this.note.textContent;
    this.button.addEventListener("pointerdown", (event) => event.button === 0 && this.press());
    this.button.addEventListener("click", (event) => event.detail === 0 && this.press());
    window.addEventListener("keydown", (event) => this.#key(event), true);
    on("driver", (driver) => this.#driver(driver));
  }

  /** Stop the plate now. */
  press() {
    if (this.button.disabled) return;
    const pressed = performance.now();
    clearTimeout(this.timer);
    this.pending = pressed;
    this.#show("pending", "sent, waiting for the answer");
    this.timer = setTimeout(() => this.#unanswered(`No answer to the emergency stop after 1 s. ${CUT}`), ANSWER_MS);
    this.connection.send({ do: "emergency_stop" }).then((answer) => {
      if (this.pending !== pressed) return;
      if (answer.ok) this.#confirm(`confirmed after ${Math.round(performance.now() - pressed)} ms`);
      else this.#unanswered(`The emergency stop failed: ${answer.text}. ${CUT}`);
    });
  }

  /** After a reconnection, send a stop again that was never confirmed. */
  again() {
    if (this.pending !== null) this.press();
  }

  /** Show on the button why it cannot be used. */
  say(text) {
    this.usual = text;
    this.#show("", text);
  }

  #key(event) {
    if (event.code !== "Space" || event.repeat || event.altKey || event.metaKey) return;
    const target = event.composedPath()[0];
    if (!event.ctrlKey && target instanceof Element && target !== this.button && takesSpace(target)) return;
    event.preventDefault();
    event.stopPropagation();
    this.press();
  }

  #driver({ state }) {
    if (this.pending !== null && (state === "braking" || state === "stopped")) {
      this.#confirm(`confirmed: motors ${state}`);
    } else if (state === "ready" && this.pending === null) {
      this.#show("", this.usual);
    }
  }

  #confirm(text) {
    clearTimeout(this.timer);
    this.pending = null;
    this.#show("confirmed", text);
    this.alarm(null);
  }

  #unanswered(text) {
    clearTimeout(this.timer);
    this.#show("unanswered", "NO ANSWER: cut the power by hand");
    this.alarm(text);
  }

  #show(state, text) {
    this.button.dataset.state = state;
    this.note.textContent = text;
  }
}

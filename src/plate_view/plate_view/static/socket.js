// The connection: commands, their replies, and reconnection.

const FIRST_WAIT_MS = 250;
const MAX_WAIT_MS = 4000;
const ANSWER_MS = 7000; // maximum wait for a reply; the server waits up to 5 s for a node
const SILENT_MS = 2500; // maximum time without a message; the server sends one at least every second
const FULL_BYTES = 8192; // number of unsent bytes above which frequent commands must wait

export class Connection {
  /** `onMessage(message)`, `image(stamp, blob)`, `changed("connected" | "silent" | "lost")` */
  constructor(address, { onMessage, image, changed }) {
    Object.assign(this, { address, onMessage, image, changed, wait: FIRST_WAIT_MS, number: 0 });
    this.waiting = new Map();
    this.state = "connecting";
    this.last = 0;
    setInterval(() => this.#listen(), 500);
    this.#open();
  }

  get full() {
    return this.socket.bufferedAmount > FULL_BYTES;
  }

  /** Send a command. The promise resolves to its reply {ok, text} and never rejects. */
  send(command) {
    if (this.socket.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ ok: false, text: "no connection" });
    }
    const number = (this.number += 1);
    return new Promise((resolve) => {
      const end = (answer) => {
        clearTimeout(timer);
        this.waiting.delete(number);
        resolve(answer);
      };
      const timer = setTimeout(() => end({ ok: false, text: "no answer" }), ANSWER_MS);
      this.waiting.set(number, end);
      this.socket.send(JSON.stringify({ ...command, number }));
    });
  }

  /** Send a message to which the server does not reply. */
  notify(command) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ ...command, number: (this.number += 1) }));
  }

  #open() {
    this.socket = new WebSocket(this.address);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.wait = FIRST_WAIT_MS;
      this.last = performance.now();
      this.#be("connected");
    };
    this.socket.onmessage = (event) => this.#receive(event.data);
    this.socket.onclose = () => this.#lose();
  }

  #receive(data) {
    this.last = performance.now();
    if (this.state === "silent") this.#be("connected");
    if (data instanceof ArrayBuffer) {
      this.image(new DataView(data).getFloat64(0, true), new Blob([data.slice(8)], { type: "image/jpeg" }));
      return;
    }
    const message = JSON.parse(data);
    if (message.kind === "answer") {
      this.waiting.get(message.number)?.(message);
    } else {
      this.onMessage(message);
    }
  }

  #lose() {
    for (const end of [...this.waiting.values()]) end({ ok: false, text: "connection lost" });
    this.#be("lost");
    setTimeout(() => this.#open(), this.wait);
    this.wait = Math.min(MAX_WAIT_MS, 2 * this.wait);
  }

  #listen() {
    if (this.state === "connected" && performance.now() - this.last > SILENT_MS) this.#be("silent");
  }

  #be(state) {
    this.state = state;
    this.changed(state);
  }
}

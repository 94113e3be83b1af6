// What the server told last, and who wants to know.

/** The newest message of each kind. */
export const known = {};

const listeners = new Map();

/** Call `listener(message)` for every message of this kind. */
export function on(kind, listener) {
  if (!listeners.has(kind)) listeners.set(kind, []);
  listeners.get(kind).push(listener);
}

/** Keep a message and tell the listeners of its kind; a fault in one does not keep it from the others. */
export function publish(message) {
  known[message.kind] = message;
  for (const listener of listeners.get(message.kind) ?? []) {
    try {
      listener(message);
    } catch (error) {
      console.error(message.kind, error);
    }
  }
}

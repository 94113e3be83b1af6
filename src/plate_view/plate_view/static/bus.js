// The latest messages from the server, and the functions that receive them.

/** The newest message of each kind. */
export const known = {};

const listeners = new Map();

/** Call `listener(message)` for every message of this kind. */
export function on(kind, listener) {
  if (!listeners.has(kind)) listeners.set(kind, []);
  listeners.get(kind).push(listener);
}

/** Store a message and call the listeners of its kind. An error in one listener does not affect the others. */
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

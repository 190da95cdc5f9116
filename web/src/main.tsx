// Entry: one store, one connection, one rendering a frame.
import { render } from "preact";
import { App } from "./app";
import { Connection } from "./connection";
import { Fetched } from "./fetched";
import { Store } from "./store";
import "./themes/page.css";

const store = new Store();
const listeners = new Set<() => void>();
let waiting = false;

function changed(): void {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    listeners.forEach((listener) => listener());
  });
}

const url = new URL("api/v1/stream", document.baseURI);
url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
const connection = new Connection(url.href, store, changed);

const fetched = new Fetched(changed);

function subscribe(callback: () => void): () => void {
  listeners.add(callback);
  return () => listeners.delete(callback);
}

const root = document.getElementById("app");
if (root) render(<App store={store} connection={connection} fetched={fetched} subscribe={subscribe} />, root);
connection.start();

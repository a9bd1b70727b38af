/** The editors of all robots, which outlive the page that shows them. */
import { app } from "../app.svelte.ts";
import { Editor } from "./editor.svelte.ts";

const editors = new Map<string, Editor>();
let epoch: number | undefined;
let client: typeof app.client | undefined;

/** The editor of a robot, which outlives the page that shows it and a gateway that is restarted, and not the login: what was entered is not lost by looking elsewhere. */
export function editorOf(robot: string): Editor {
  if (client !== app.client) editors.clear();
  else if (epoch !== app.epoch) for (const one of editors.values()) one.forget();
  ({ client, epoch } = app);
  let found = editors.get(robot);
  if (!found) editors.set(robot, (found = made()));
  return found;
}

// Reloading or closing the page would lose what was entered.
addEventListener("beforeunload", (event) => {
  if (client === app.client && [...editors.values()].some((one) => one.busy || one.pending.size)) event.preventDefault();
});

function made(): Editor {
  const { client } = app;
  const given = (approval: string | undefined): { approval?: string } => (approval === undefined ? {} : { approval });
  return new Editor({
    device: {
      write: (path, value, approval) => client.write(path, value, given(approval)),
      writeAll: (values, approval) => client.writeAll(values, given(approval)),
      read: async (path) => (await client.read(path, { fresh: true })).value,
    },
    execute: (path) => client.execute(path).result,
    look: async (path) => (await client.read(path)).value,
    pages: (pattern) => client.pages(pattern),
  });
}

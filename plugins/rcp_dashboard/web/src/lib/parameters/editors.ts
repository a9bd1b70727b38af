/** The editors of all robots, which outlive the page that shows them. */
import { app } from "../app.svelte.ts";
import { Editor } from "./editor.svelte.ts";

const editors = new Map<string, Editor>();
let client: typeof app.client | undefined;

/** The editor of a robot, which outlives the page that shows it and a gateway that was started again, and not the login: what was entered is not lost. */
export function editorOf(robot: string): Editor {
  if (client !== app.client) editors.clear();
  client = app.client;
  let found = editors.get(robot);
  if (!found) editors.set(robot, (found = made()));
  return found;
}

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
    pages: (pattern) => client.pages(pattern),
  });
}

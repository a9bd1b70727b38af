/** Notes in a small part of Markdown: headings, lists, paragraphs, code; in a line bold, italic, code and links. */

export type Span = { kind: "text" | "bold" | "italic" | "code"; text: string } | { kind: "link"; text: string; href: string };
export type Block = { kind: "heading"; level: 1 | 2 | 3; spans: Span[] } | { kind: "paragraph"; spans: Span[] } | { kind: "list"; ordered: boolean; items: Span[][] } | { kind: "code"; text: string };

const INLINE = /`([^`]+)`|\*\*([^*]+)\*\*|\*([^*\s][^*]*)\*|\[([^\]]+)\]\(([^()\s]+)\)/g;
/** Links lead to pages of the web or of this one: nothing that runs. */
const SAFE = /^(https?:\/\/|#\/)/i;

export function spans(text: string): Span[] {
  const found: Span[] = [];
  let from = 0;
  const plain = (to: number): unknown => to > from && found.push({ kind: "text", text: text.slice(from, to) });
  for (const match of text.matchAll(INLINE)) {
    const [whole, code, bold, italic, name, href] = match;
    if (href !== undefined && !SAFE.test(href)) continue;
    plain(match.index);
    if (code !== undefined) found.push({ kind: "code", text: code });
    else if (bold !== undefined) found.push({ kind: "bold", text: bold });
    else if (italic !== undefined) found.push({ kind: "italic", text: italic });
    else found.push({ kind: "link", text: name as string, href: href as string });
    from = match.index + whole.length;
  }
  plain(text.length);
  return found;
}

export function blocks(text: string): Block[] {
  const found: Block[] = [];
  let open: string[] = [];
  const close = (): void => {
    if (open.length) found.push({ kind: "paragraph", spans: spans(open.join(" ")) });
    open = [];
  };
  const lines = text.split("\n");
  for (let at = 0; at < lines.length; at++) {
    const line = (lines[at] as string).trimEnd();
    const heading = /^(#{1,3})\s+(.+)$/.exec(line);
    const item = /^\s*(?:[-*+]|(\d+)[.)])\s+(.+)$/.exec(line);
    if (line.startsWith("```")) {
      close();
      const end = lines.findIndex((one, place) => place > at && one.startsWith("```"));
      found.push({ kind: "code", text: lines.slice(at + 1, end < 0 ? undefined : end).join("\n") });
      at = end < 0 ? lines.length : end;
    } else if (heading) {
      close();
      found.push({ kind: "heading", level: heading[1]!.length as 1 | 2 | 3, spans: spans(heading[2]!) });
    } else if (item) {
      close();
      const ordered = item[1] !== undefined;
      const last = found.at(-1);
      const list = last?.kind === "list" && last.ordered === ordered && (lines[at - 1] ?? "").trim() !== "" ? last : undefined;
      if (list) list.items.push(spans(item[2]!));
      else found.push({ kind: "list", ordered, items: [spans(item[2]!)] });
    } else if (line.trim() === "") close();
    else open.push(line.trim());
  }
  close();
  return found;
}

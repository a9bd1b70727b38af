/** Finds the texts of the pages in their source and puts calls in their place that look them up. */
import { parse } from "svelte/compiler";

import { isText } from "./rules.ts";

/** A text of the pages: `many` beside `one` where a number decides between the two. */
export interface Text {
  one: string;
  many?: string;
}

export interface Found {
  code: string;
  texts: Text[];
  /** Texts that are read once, when the module is loaded, and so would stay in the first language. */
  early: string[];
}

/** The calls as they stand in what is built. */
const SAY = "say_";
const COUNT = "count_";
const IMPORT = `import { say as ${SAY}, counted as ${COUNT} } from "/src/lib/language.svelte.ts";`;
const PROGRAM = '<script lang="ts">';

interface Place {
  /** Whether what stands here is shown as it is. */
  shown: boolean;
  attribute?: string;
  /** Not an element of HTML. */
  component?: boolean;
  /** The function to which it is handed. */
  call?: string;
  /** Outside of all functions of a module. */
  early?: boolean;
  /** Nothing here is for people, apart from what is in functions. */
  mute?: boolean;
}

type Node = any; // of two trees, Svelte's and that of its scripts

/** Find the texts of a component or module, and return it with calls in their place. */
export function translate(source: string, file: string): Found {
  const component = file.endsWith(".svelte");
  const offset = component ? 0 : PROGRAM.length;
  const root = parse(component ? source : `${PROGRAM}${source}</script>`, { modern: true }) as Node;
  const walk = new Walk(source, offset);
  if (root.module) walk.visit(root.module.content, { shown: false, early: true });
  if (root.instance) walk.visit(root.instance.content, { shown: false, early: !component });
  if (component) walk.visit(root.fragment, { shown: false });
  return { code: walk.finish(component ? (root.instance ?? root.module)?.content.start : 0), texts: walk.texts, early: walk.early };
}

const HUMAN = new Set(["title", "aria-label", "placeholder", "alt", "label", "aria-valuetext", "aria-description", "aria-roledescription"]);
const MUTE = /^(class|style|id|type|role|name|for|href|src|d|fill|stroke|viewBox|transform|testid|data-.*|aria-(live|hidden|pressed|expanded|controls|current|haspopup|labelledby|describedby)|autocomplete|inputmode|spellcheck|tabindex|on[a-z]+)$/;
const SILENT = new Set(["script", "style", "code", "pre"]);
const COMPARES = new Set(["===", "!==", "==", "!=", "in", "<", ">", "<=", ">=", "instanceof"]);

class Walk {
  readonly texts: Text[] = [];
  readonly early: string[] = [];
  readonly #edits: { start: number; end: number; text: string }[] = [];
  readonly #source: string;
  readonly #offset: number;

  constructor(source: string, offset: number) {
    this.#source = source;
    this.#offset = offset;
  }

  finish(start: number | undefined): string {
    if (this.#edits.length === 0) return this.#source;
    const edits = this.#edits.map((edit, at) => ({ ...edit, at })).sort((a, b) => b.start - a.start || b.end - a.end || b.at - a.at);
    let code = this.#source;
    if (start === undefined) code = `<script lang="ts">${IMPORT}</script>${code}`;
    for (const { start: from, end, text } of edits) code = start === undefined ? put(code, from + IMPORT.length + PROGRAM.length + 9, end + IMPORT.length + PROGRAM.length + 9, text) : put(code, from, end, text);
    return start === undefined ? code : put(code, start, start, IMPORT);
  }

  visit(node: Node, place: Place): void {
    if (!node || typeof node.type !== "string") return;
    const own = (this as any)[node.type] as ((node: Node, place: Place) => void) | undefined;
    if (own) own.call(this, node, place);
    else if (!/^TS|^Import|Comment$|StyleSheet/.test(node.type)) this.#children(node, { ...place, shown: false });
  }

  #children(node: Node, place: Place, ...skipped: string[]): void {
    for (const [key, child] of Object.entries(node)) {
      if (skipped.includes(key) || /^(type|typeAnnotation|typeParameters|typeArguments|returnType|superTypeParameters|implements|metadata|loc)$/.test(key)) continue;
      for (const one of Array.isArray(child) ? child : [child]) this.visit(one, place);
    }
  }

  // ---- markup

  Fragment(node: Node, place: Place): void {
    let run: Node[] = [];
    for (const one of node.nodes) {
      if (one.type === "Text" || one.type === "ExpressionTag") run.push(one);
      else if (one.type !== "Comment") {
        this.#run(run, { shown: true, ...(place.mute && { mute: true }) });
        run = [];
        this.visit(one, place);
      }
    }
    this.#run(run, { shown: true, ...(place.mute && { mute: true }) });
  }

  /** Texts and expressions beside each other are one text, with places for the expressions. */
  #run(run: Node[], place: Place): void {
    for (const one of run) if (one.type === "ExpressionTag") this.visit(one.expression, place);
    const parts = [...run];
    while (parts.length && parts[0].type === "Text" && parts[0].data.trim() === "") parts.shift();
    while (parts.length && parts.at(-1).type === "Text" && parts.at(-1).data.trim() === "") parts.pop();
    let holes = 0;
    const text = parts.map((one) => (one.type === "Text" ? one.data : `{${holes++}}`)).join("").replaceAll(/\s+/g, " ").trim();
    if (place.mute || !parts.some((one) => one.type === "Text") || !isText(text, true)) return;
    this.texts.push({ one: text });
    const first = parts[0];
    const last = parts.at(-1);
    const from = first.type === "Text" ? first.start + first.raw.length - first.raw.trimStart().length : first.start;
    const to = last.type === "Text" ? last.end - (last.raw.length - last.raw.trimEnd().length) : last.end;
    this.#calls(text, from, to, parts.filter((one) => one.type === "ExpressionTag").map((one) => ({ start: one.expression.start, end: one.expression.end })), "{", "}");
  }

  /** Write a call over `from` to `to` that keeps the expressions where they are. */
  #calls(text: string, from: number, to: number, holes: { start: number; end: number }[], before = "", after = ""): void {
    let at = from;
    let open = `${before}${SAY}(${JSON.stringify(text)}`;
    for (const hole of holes) {
      this.#edit(at, hole.start, `${open}, (`);
      open = ")";
      at = hole.end;
    }
    this.#edit(at, to, `${open})${after}`);
  }

  #edit(start: number, end: number, text: string): void {
    this.#edits.push({ start: start - this.#offset, end: end - this.#offset, text });
  }

  RegularElement(node: Node, place: Place): void {
    for (const one of node.attributes) this.visit(one, { ...place, component: false });
    this.visit(node.fragment, SILENT.has(node.name) ? { ...place, mute: true } : { ...place, mute: false });
  }

  Component(node: Node, place: Place): void {
    for (const one of node.attributes) this.visit(one, { ...place, component: true });
    this.visit(node.fragment, place);
  }

  Attribute(node: Node, place: Place): void {
    if (node.value === true) return;
    const human = HUMAN.has(node.name);
    const inner: Place = { shown: human, attribute: node.name, component: place.component ?? false, mute: !human && ((MUTE.test(node.name) && node.name !== "name") || !place.component) };
    if (!Array.isArray(node.value)) return this.visit(node.value.expression, inner);
    for (const one of node.value) if (one.type === "ExpressionTag") this.visit(one.expression, inner);
    let holes = 0;
    const text = node.value.map((one: Node) => (one.type === "Text" ? one.data : `{${holes++}}`)).join("");
    if (inner.mute || !node.value.some((one: Node) => one.type === "Text") || !isText(text, human)) return;
    this.texts.push({ one: text });
    const quoted = /["']/.test(this.#source[node.value[0].start - 1] ?? "") ? 1 : 0;
    const tags = node.value.filter((one: Node) => one.type === "ExpressionTag").map((one: Node) => ({ start: one.expression.start, end: one.expression.end }));
    this.#calls(text, node.value[0].start - quoted, node.value.at(-1).end + quoted, tags, "{", "}");
  }

  ExpressionTag(node: Node, place: Place): void {
    this.visit(node.expression, { ...place, shown: true });
  }

  // ---- scripts

  Literal(node: Node, place: Place): void {
    if (typeof node.value !== "string" || !this.#wanted(node.value, place)) return;
    if (place.early) this.early.push(node.value);
    this.texts.push({ one: node.value });
    this.#edit(node.start, node.end, `${SAY}(${JSON.stringify(node.value)})`);
  }

  TemplateLiteral(node: Node, place: Place): void {
    for (const one of node.expressions) this.visit(one, { ...place, call: undefined } as any);
    const text: string = node.quasis.map((one: Node, at: number) => one.value.cooked + (at < node.expressions.length ? `{${at}}` : "")).join("");
    if (!this.#wanted(text, place)) return;
    if (place.early) this.early.push(text);
    this.texts.push({ one: text });
    this.#calls(text, node.start, node.end, node.expressions);
  }

  #wanted(text: string, place: Place): boolean {
    return !place.mute && isText(text, place.shown, place.call);
  }

  TaggedTemplateExpression(node: Node, place: Place): void {
    for (const one of node.quasi.expressions) this.visit(one, { ...place, shown: false });
  }

  ConditionalExpression(node: Node, place: Place): void {
    const { test, consequent, alternate } = node;
    this.visit(test, { ...place, shown: false });
    const counts = test.type === "BinaryExpression" && test.operator === "===" && test.right.value === 1;
    if (counts && [consequent, alternate].every((one) => one.type === "Literal" && typeof one.value === "string" && one.value !== "") && !place.mute) {
      this.texts.push({ one: consequent.value, many: alternate.value });
      this.#edit(node.start, test.left.start, `${COUNT}((`);
      this.#edit(test.left.end, node.end, `), ${JSON.stringify(consequent.value)}, ${JSON.stringify(alternate.value)})`);
      return;
    }
    this.visit(consequent, place);
    this.visit(alternate, place);
  }

  LogicalExpression(node: Node, place: Place): void {
    this.visit(node.left, node.operator === "&&" ? { ...place, shown: false } : place);
    this.visit(node.right, place);
  }

  BinaryExpression(node: Node, place: Place): void {
    const compares = COMPARES.has(node.operator);
    for (const one of [node.left, node.right]) if (!(compares && /Literal$/.test(one.type))) this.visit(one, compares ? { ...place, shown: false } : place);
  }

  CallExpression(node: Node, place: Place): void {
    this.visit(node.callee, { ...place, shown: false });
    if (/^(say|vocabulary|counted)$/.test(node.callee.name ?? "")) return this.#named(node, place);
    const call = this.#source.slice(node.callee.start - this.#offset, node.callee.end - this.#offset).split(/\.|\?/).at(-1)!.replace("#", "");
    for (const one of node.arguments) this.visit(one, { ...place, shown: false, call });
  }

  /** What the source itself looks up, or names to be looked up. */
  #named({ callee, arguments: given }: Node, place: Place): void {
    const literal = given.flatMap(literals);
    if (callee.name === "counted") this.texts.push({ one: literal[0], many: literal[1] });
    else this.texts.push(...literal.map((one: string) => ({ one })));
    for (const one of given) if (literals(one).length === 0) this.visit(one, { ...place, shown: false });
  }

  NewExpression(node: Node, place: Place): void {
    for (const one of node.arguments) this.visit(one, { ...place, shown: false, call: `new ${node.callee.name ?? ""}` });
  }

  Property(node: Node, place: Place): void {
    if (node.computed) this.visit(node.key, { ...place, shown: false });
    const key = node.key.name ?? node.key.value;
    const inner: Place = { ...place, shown: false, attribute: key, ...(MUTE.test(String(key)) && key !== "name" && { mute: true }) };
    const direct = /Literal$/.test(node.value?.type ?? "") && node.value.type !== "TaggedTemplate";
    if (!place.early || !direct || node.computed) return this.visit(node.value, inner);
    const before = this.#edits.length;
    this.visit(node.value, { ...inner, early: false });
    if (this.#edits.length === before) return;
    // A getter is read anew in each language.
    const start = node.value.start;
    this.#edits.splice(before, 0, { start: node.start - this.#offset, end: node.start - this.#offset, text: "get " }, { start: node.key.end - this.#offset, end: start - this.#offset, text: "() { return " });
    this.#edit(node.end, node.end, "; }");
  }

  MemberExpression(node: Node, place: Place): void {
    this.visit(node.object, { ...place, shown: false });
    if (node.computed && node.property.type !== "Literal") this.visit(node.property, { ...place, shown: false, mute: true });
  }

  SwitchCase(node: Node, place: Place): void {
    for (const one of node.consequent) this.visit(one, { ...place, shown: false });
  }

  ArrowFunctionExpression(node: Node, place: Place): void {
    const inner: Place = { shown: place.shown };
    for (const one of node.params) this.visit(one, { shown: false, mute: true });
    this.visit(node.body, node.body.type === "BlockStatement" ? { shown: false } : inner);
  }

  FunctionExpression(node: Node): void {
    for (const one of node.params) this.visit(one, { shown: false, mute: true });
    this.visit(node.body, { shown: false });
  }

  FunctionDeclaration(node: Node): void {
    this.FunctionExpression(node);
  }

  PropertyDefinition(node: Node): void {
    this.visit(node.value, { shown: false });
  }

  TSAsExpression(node: Node, place: Place): void {
    this.visit(node.expression, place);
  }

  TSSatisfiesExpression(node: Node, place: Place): void {
    this.visit(node.expression, place);
  }

  TSNonNullExpression(node: Node, place: Place): void {
    this.visit(node.expression, place);
  }

  ExportAllDeclaration(): void {}

  ExportNamedDeclaration(node: Node, place: Place): void {
    this.visit(node.declaration, place);
  }
}

/** The strings among which an expression chooses. */
function literals(node: Node): string[] {
  if (node.type === "ConditionalExpression") return [...literals(node.consequent), ...literals(node.alternate)];
  return typeof node.value === "string" ? [node.value] : [];
}

function put(code: string, from: number, to: number, text: string): string {
  return code.slice(0, from) + text + code.slice(to);
}

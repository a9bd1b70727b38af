import { keep, kept } from "./kept.ts";

const KEY = "rcp.language";

/** The texts of a language by those of the source; several where a number decides, in the order of CLDR. */
export type Catalogue = Record<string, string | string[]>;

/** What the page speaks, by its name in itself. */
export const LANGUAGES: Record<string, string> = { en: "English", de: "Deutsch" };

/** English is in the source: it needs no catalogue. */
const CATALOGUES: Record<string, () => Promise<{ default: Catalogue }>> = { de: () => import("virtual:words/de") };

/** The language of the page: as the person chose, else as the browser asks for. */
class Language {
  /** What the texts are in: a language counts as chosen when its catalogue is there. */
  code = $state("en");
  /** A catalogue could not be fetched. */
  failed = $state(false);
  #texts = $state.raw<Catalogue>({});
  #plurals = new Intl.PluralRules("en");
  /** For numbers and dates: the browser's own where it is of this language, as there are several of each. */
  readonly locale = $derived((globalThis.navigator?.languages ?? []).find((one) => one.split("-")[0] === this.code) ?? this.code);

  /** Whether it writes 1,5 and not 1.5. */
  readonly comma = $derived(new Intl.NumberFormat(this.locale).format(1.5).includes(","));

  /** Choose a language and keep the choice; the page stays as it was where its texts cannot be fetched. */
  async choose(code: string): Promise<void> {
    if (await this.#speak(code)) keep(KEY, code, "computer");
  }

  /** Begin with the language that was chosen, or that the browser asks for. */
  async begin(): Promise<void> {
    const asked = [kept(KEY) ?? "", ...(globalThis.navigator?.languages ?? []).map((one) => one.split("-")[0] ?? "")];
    await this.#speak(asked.find((one) => one in LANGUAGES) ?? "en");
  }

  async #speak(code: string): Promise<boolean> {
    try {
      const texts = (await CATALOGUES[code]?.())?.default ?? {};
      this.failed = false;
      this.#texts = texts;
      this.#plurals = new Intl.PluralRules(code);
      this.code = code;
      if (globalThis.document) document.documentElement.lang = code; // tests have none
      return true;
    } catch {
      this.failed = true; // of an older page, or of a gateway that is away
      return false;
    }
  }

  text(source: string): string {
    const told = this.#texts[source];
    return typeof told === "string" ? told : (source.split("¦")[0] as string);
  }

  counted(count: number, one: string, many: string): string {
    const forms = this.#texts[`${one}\0${many}`];
    if (!Array.isArray(forms)) return count === 1 ? one : many;
    const at = this.#plurals.resolvedOptions().pluralCategories.toSorted((a, b) => ORDER.indexOf(a) - ORDER.indexOf(b)).indexOf(this.#plurals.select(count));
    return forms[at] ?? many;
  }
}

const ORDER = ["zero", "one", "two", "few", "many", "other"];

export const language = new Language();

/** The text in the language of the page, with the values at its places; what follows `¦` tells words apart that are one in English. The build puts this call around every text of the source. */
export function say(source: string, ...values: unknown[]): string {
  const told = language.text(source);
  return values.length ? told.replaceAll(/\{(\d+)\}/g, (_, at: string) => String(values[Number(at)] ?? "")) : told;
}

/** What goes with a number of things. The build puts this call where the source chooses with `=== 1`. */
export function counted(number: number, one: string, many: string): string {
  return language.counted(number, one, many);
}

/** Name words that come from elsewhere, such as states, so that they are in the catalogue; `say` translates them. */
export function vocabulary(..._: string[]): void {}

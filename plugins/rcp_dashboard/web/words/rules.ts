/** What of the strings in the source is a text for people. */

/** Functions whose strings are not for people. */
const CALLS = new Set(
  `querySelector querySelectorAll matches closest addEventListener removeEventListener getElementById setAttribute getAttribute createElement kept keep getItem setItem
  startsWith endsWith includes indexOf split join replace replaceAll may on off import getContext subscribe read execute write fetch has get set append test match
  toDateString createElementNS dispatchEvent log warn debug`.split(/\s+/),
);
const CONSTRUCTORS = /^new (?!\w*(Error|Lost|Refused)$)/;
const UNITS = /^\W*(?:(?:\{\d+\}|[\d.,\s+\-–×·…:/()*²³°%±])|\b(?:mm|cm|m|km|ms|s|min|h|d|Hz|kHz|rad|deg|V|A|W|Wh|mAh|N|Nm|kg|kB|MB|GB|B|KiB|MiB|GiB|ft|mi|mph|kn|lb|RCP|CSV|JSON|XY|x|y|z|px|dBm|hPa|Pa)\b)+\W*$/;

/**
 * Whether a string is a text. `shown`: it stands where the page shows it as it is; elsewhere it must
 * look like a sentence or a title.
 */
export function isText(text: string, shown: boolean, call = ""): boolean {
  const words = text.replaceAll(/\{\d+\}/g, "");
  if (!(/\p{L}{2}/u.test(words) || (shown && text === "a")) || UNITS.test(text) || NOT_TEXTS.has(text) || CODE.test(text)) return false;
  if (shown) return true;
  if (CALLS.has(call) || CONSTRUCTORS.test(call)) return false;
  if (/^[\w-]+\/\S*$|^[./#@[<&?]|^\S*[_/]\S*$|[=<>]|;\S|;$|::|^\S+:\S/.test(text)) return false;
  if (/^\P{L}*\p{Lu}\p{Ll}+(\P{L}|$)/u.test(words)) return true;
  return /\p{L}{2,}.* \P{L}*\p{L}{2,}|\p{L}{2,} \{|\} \p{L}{2,}/u.test(text);
}

/** Strings that look like texts and are none: keys, names of keys on the keyboard, requests. */
const NOT_TEXTS = new Set([
  "Polygon", // of the geometry of tiles
  "Point",
  "line strip", // types of markers, as ROS names them
  "line list",
  "cube list",
  "sphere list",
  "arrow strip",
  "Plots", // the name under which plots are kept
  "stopped on the dashboard", // reasons, for the record of the gateway
  "reset on the dashboard",
  "low battery", // a key; `vocabulary` has the text
  "FENCE_ENABLE",
  "input[data-value], select[data-value]",
  "curl",
  "rcpctl",
  "index.html has no #app",
]);

/** Requests, fonts, and what the parts of a scene are called within the page. */
const CODE = /^Bearer |system-ui|^\(prefers-|^(curl|rcpctl) |^minmax|^(frames|joints|robot|pose|ned|mean|markers|update) \{0\}$/;

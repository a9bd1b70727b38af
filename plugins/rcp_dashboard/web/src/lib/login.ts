import { ConnectionLost, RcpError } from "rcp-client";

/** The login that the gateway keeps for this browser: a cookie that no script can read stands for it. */

const PATIENCE = 15_000; // ms
const NONE = [403, 404]; // where the gateway keeps no logins, or not for this page

/** An issuer at which people log in or out, and where the browser goes for it. */
export interface IssuerLink {
  name: string;
  url: string;
}

interface Told {
  principal?: string | null;
  durable?: boolean;
  issuers?: IssuerLink[];
  log_out_at?: IssuerLink | null;
  error?: ConstructorParameters<typeof RcpError>[0];
}

interface Answer {
  status: number;
  told: Told | undefined;
}

/** Whether the browser has one that has not ended. */
export async function isLoggedIn(base: string): Promise<boolean> {
  const answer = await ask(base, "GET");
  return typeof answer?.told?.principal === "string"; // what else is wrong, the connection tells
}

/**
 * Begin one; return whether the gateway keeps it: not where a restart would log everybody out, nor over plain HTTP from afar.
 *
 * Rejects with an `RcpError` where it refuses the token, or does not answer: then nothing is to be kept anywhere.
 */
export async function beginLogin(base: string, token: string, remember: boolean): Promise<boolean> {
  if ((await ask(base, "GET"))?.told?.durable === false) return false;
  const answer = await ask(base, "POST", JSON.stringify({ token, remember }));
  if (answer?.status === 200) return true;
  if (answer && NONE.includes(answer.status)) return false;
  if (answer?.told?.error) throw new RcpError(answer.told.error);
  throw new ConnectionLost("no response from the gateway", "Try again.");
}

/** End it, if there is one; return whether there is none now (without that, the browser is still logged in), and where the issuer ends its own. */
export async function endLogin(base: string): Promise<{ ended: boolean; logOutAt?: IssuerLink }> {
  const answer = await ask(base, "DELETE");
  const ended = answer !== undefined && [200, ...NONE].includes(answer.status);
  const place = answer?.told?.log_out_at;
  return { ended, ...(place && { logOutAt: place }) };
}

/** Return the issuers at which people log in, instead of by a key. */
export async function issuersOf(base: string): Promise<IssuerLink[]> {
  return (await ask(base, "GET"))?.told?.issuers ?? [];
}

/** Return where the browser goes to log in at an issuer, and come back to the page at `hash`. */
export function loginAt(issuer: IssuerLink, hash: string, remember: boolean): string {
  const query = new URLSearchParams({ next: `/${hash}`, ...(remember && { remember: "true" }) });
  return `${issuer.url}?${query}`;
}

/** Return what the gateway answers; undefined if it does not answer in time. */
async function ask(base: string, method: string, body?: string): Promise<Answer | undefined> {
  const headers = { "content-type": "application/json" };
  try {
    const answer = await fetch(`${base}/rcp/v1/login`, { method, ...(body !== undefined && { body }), headers, signal: AbortSignal.timeout(PATIENCE) });
    return { status: answer.status, told: await answer.json().catch(() => undefined) };
  } catch {
    return undefined;
  }
}

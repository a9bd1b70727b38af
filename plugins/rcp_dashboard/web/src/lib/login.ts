/** The login that the gateway keeps for this browser: a cookie that no script can read stands for it. */

const PATIENCE = 15_000; // ms

/** Whether the browser has one that has not ended. */
export async function isLoggedIn(base: string): Promise<boolean> {
  const told = await ask(base, "GET");
  return typeof told?.principal === "string"; // what else is wrong, the connection tells
}

/** Begin one; return whether the gateway keeps it: not where a restart would log everybody out, nor over plain HTTP from afar. */
export async function beginLogin(base: string, token: string, remember: boolean): Promise<boolean> {
  if ((await ask(base, "GET"))?.durable !== true) return false;
  return (await ask(base, "POST", JSON.stringify({ token, remember }))) !== undefined;
}

/** End it; return whether the gateway has: without that, the browser is still logged in. */
export async function endLogin(base: string): Promise<boolean> {
  return (await ask(base, "DELETE")) !== undefined;
}

/** Return what the gateway answers; undefined if it refuses, or does not answer in time. */
async function ask(base: string, method: string, body?: string): Promise<{ principal: string | null; durable: boolean } | undefined> {
  const headers = { "content-type": "application/json" };
  try {
    const answer = await fetch(`${base}/rcp/v1/login`, { method, ...(body !== undefined && { body }), headers, signal: AbortSignal.timeout(PATIENCE) });
    const told = await answer.json();
    return answer.ok ? told : undefined;
  } catch {
    return undefined;
  }
}

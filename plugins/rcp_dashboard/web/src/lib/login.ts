/** The login that the gateway keeps for this browser: a cookie that no script can read stands for it. */

const PATIENCE = 5000; // ms

/** Whether the browser has one that has not ended. */
export async function isLoggedIn(base: string): Promise<boolean> {
  const answer = await ask(base, "GET").catch(() => undefined); // the connection tells what is wrong
  return answer?.ok === true && (await answer.json()).principal !== null;
}

/** Begin one; return whether the gateway keeps it: it may not, and does not over plain HTTP from afar. */
export async function beginLogin(base: string, token: string, remember: boolean): Promise<boolean> {
  const answer = await ask(base, "POST", JSON.stringify({ token, remember })).catch(() => undefined);
  return answer?.ok === true;
}

/** End it; return whether the gateway has: without that, the browser is still logged in. */
export async function endLogin(base: string): Promise<boolean> {
  const answer = await ask(base, "DELETE").catch(() => undefined);
  return answer?.ok === true;
}

function ask(base: string, method: string, body?: string): Promise<Response> {
  const headers = { "content-type": "application/json" };
  return fetch(`${base}/rcp/v1/login`, { method, ...(body !== undefined && { body }), headers, signal: AbortSignal.timeout(PATIENCE) });
}

/** Sessions, logins and keys as the gateway lists them, and what ending one of them means. */
import { say } from "./language.svelte.ts";

export const SESSIONS = "/system/sessions";
export const LOGINS = "/system/logins";
export const KEYS = "/system/keys";

export interface Session {
  session: string;
  principal: string;
  tenant: string | null;
  transport: string;
  connected: boolean;
  address: string | null;
  login: string | null;
  created: string;
  subscriptions: number;
  commands: number;
  backlog: number;
}

export interface Login {
  login: string;
  principal: string;
  proof: string;
  address: string | null;
  remembered: boolean;
  begun: string;
  used: string;
  expires: string;
  sessions: number;
}

export interface Key {
  key: string;
  principal: string;
  grants: Record<string, string[]>;
  state: "good" | "expired" | "revoked";
  created: string;
  expires: string | null;
  revoked: string | null;
}

/** What is asked before something ends, and what is sent then. */
export interface End {
  title: string;
  text: string;
  verb: string;
  path: string;
  input: Record<string, string>;
}

export function endOfSession({ principal, session, login }: Session, holds: string[]): End {
  const control = holds.length ? `It has control of ${holds.join(", ")}, which comes to rest. ` : "";
  const back = login === null ? "Its program can connect again with the same key: to keep it out, revoke the key." : "Its page can connect again by its login: to keep it out, end the login.";
  return { title: `End the session of ${principal}?`, text: control + back, verb: "End session", path: LOGINS, input: { session } };
}

export function endOfLogin({ principal, login, sessions }: Login): End {
  const text = `${sessions === 1 ? "1 open page is" : `${sessions} open pages are`} logged out at once. ${principal} can log in again with the key or token.`;
  return { title: `End the login of ${principal}?`, text, verb: "End login", path: LOGINS, input: { login } };
}

export function endOfKey({ principal, key }: Key): End {
  return { title: `Revoke the key ${key} of ${principal}?`, text: "Its sessions and logins end at once, and it is never valid again.", verb: "Revoke key", path: KEYS, input: { revoke: key } };
}

export function rightsOf({ grants }: Key): string {
  return Object.entries(grants).map(([tenant, roles]) => `${tenant === "*" ? "all tenants" : tenant}: ${roles.join(", ")}`).join(" · ") || say("none");
}

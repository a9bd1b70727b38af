import { afterEach, describe, expect, it, vi } from "vitest";

import { beginLogin, endLogin, issuersOf, loginAt } from "../src/lib/login.ts";

afterEach(() => vi.unstubAllGlobals());

function answering(status: number, told: unknown): void {
  vi.stubGlobal("fetch", async () => new Response(JSON.stringify(told), { status }));
}

const refusal = (code: string): unknown => ({ error: { code, message: "no", remedy: "Do otherwise." } });

describe("a login", () => {
  it("is kept by the gateway, or by the page where the gateway keeps none", async () => {
    answering(200, { principal: "ann", expires: null });
    expect(await beginLogin("", "token", true)).toBe(true);
    for (const [status, code] of [[403, "forbidden"], [404, "unknown_path"]] as const) {
      answering(status, refusal(code));
      expect(await beginLogin("", "token", true)).toBe(false);
    }
    answering(200, { principal: null, expires: null, durable: false });
    expect(await beginLogin("", "token", true)).toBe(false);
  });

  it("is kept nowhere if the token is refused, or nobody answers", async () => {
    for (const [status, code] of [[401, "unauthenticated"], [429, "rate_limited"], [503, "adapter_unavailable"]] as const) {
      answering(status, refusal(code));
      await expect(beginLogin("", "token", true)).rejects.toMatchObject({ code });
    }
    answering(502, "a proxy");
    await expect(beginLogin("", "token", true)).rejects.toMatchObject({ code: "connection_lost" });
    vi.stubGlobal("fetch", async () => Promise.reject(new TypeError("no network")));
    await expect(beginLogin("", "token", true)).rejects.toMatchObject({ code: "connection_lost" });
  });

  it("has ended where the gateway has ended it, or keeps none", async () => {
    for (const [status, ended] of [[200, true], [403, true], [404, true], [503, false]] as const) {
      answering(status, {});
      expect(await endLogin("")).toEqual({ ended });
    }
  });

  it("may be begun and ended at an issuer", async () => {
    const issuer = { name: "House & Co", url: "https://robots.example/rcp/v1/login/oidc/house" };
    answering(200, { principal: null, durable: true, issuers: [issuer], log_out_at: issuer });
    expect(await issuersOf("")).toEqual([issuer]);
    expect(await endLogin("")).toEqual({ ended: true, logOutAt: issuer });
    expect(loginAt(issuer, "#/explore?path=/a", true)).toBe(`${issuer.url}?next=%2F%23%2Fexplore%3Fpath%3D%2Fa&remember=true`);
    expect(loginAt(issuer, "", false)).toBe(`${issuer.url}?next=%2F`);
    answering(404, refusal("unknown_path"));
    expect(await issuersOf("")).toEqual([]);
  });
});

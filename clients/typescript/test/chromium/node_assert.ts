// What the tests use of node:assert/strict, for a page.
function ok(value: unknown, message = `not so: ${String(value)}`): asserts value {
  if (!value) throw new Error(message);
}

function equal(found: unknown, expected: unknown, message = `${String(found)} is not ${String(expected)}`): void {
  ok(Object.is(found, expected), message);
}

/** Compare plain data: the order of keys does not matter, and what is undefined counts. */
function same(found: unknown, expected: unknown): boolean {
  if (typeof found !== "object" || typeof expected !== "object" || found === null || expected === null)
    return Object.is(found, expected);
  const keys = Object.keys(found);
  return (
    Array.isArray(found) === Array.isArray(expected) &&
    keys.length === Object.keys(expected).length &&
    keys.every((key) => key in expected && same((found as Record<string, unknown>)[key], (expected as Record<string, unknown>)[key]))
  );
}

function deepEqual(found: unknown, expected: unknown): void {
  ok(same(found, expected), `${JSON.stringify(found)} is not ${JSON.stringify(expected)}`);
}

export default { ok, equal, deepEqual };

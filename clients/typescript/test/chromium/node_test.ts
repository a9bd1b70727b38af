// What the tests use of node:test, for a page: tests/browser/test_typescript_client.py puts it in its place.
interface Mock {
  mock: { timers: Timers };
}
type Body = (t: Mock) => unknown;

const tests: { name: string; body: Body }[] = [];
const afterwards: (() => unknown)[] = [];
const own = { setTimeout: globalThis.setTimeout.bind(globalThis), clearTimeout: globalThis.clearTimeout.bind(globalThis) };

export function test(name: string, body: Body): void {
  tests.push({ name, body });
}

export function afterEach(body: () => unknown): void {
  afterwards.push(body);
}

/** Timers that go off when a test says so; those that are left when they are reset never do. */
class Timers {
  #now = 0;
  #last = 0;
  #waiting = new Map<number, { due: number; call: () => void }>();

  enable(_: { apis: string[] }): void {
    globalThis.setTimeout = ((call: () => void, wait = 0) => {
      this.#last -= 1; // none of the page's own
      this.#waiting.set(this.#last, { due: this.#now + wait, call });
      return this.#last;
    }) as typeof setTimeout;
    globalThis.clearTimeout = ((id: number) => this.#waiting.delete(id) || own.clearTimeout(id)) as typeof clearTimeout;
  }

  tick(passed: number): void {
    const end = this.#now + passed;
    for (;;) {
      const [next] = [...this.#waiting].sort(([, a], [, b]) => a.due - b.due);
      if (next === undefined || next[1].due > end) break;
      this.#waiting.delete(next[0]);
      this.#now = next[1].due;
      next[1].call();
    }
    this.#now = end;
  }

  reset(): void {
    Object.assign(globalThis, own);
  }
}

/** Run all tests, one after the other; return the names of those that passed, and what the others threw. */
async function run(): Promise<{ passed: string[]; failed: string[] }> {
  const passed: string[] = [];
  const failed: string[] = [];
  for (const { name, body } of tests) {
    const timers = new Timers();
    try {
      await body({ mock: { timers } });
      passed.push(name);
    } catch (error) {
      failed.push(`${name}: ${(error as Error).stack ?? error}`);
    } finally {
      timers.reset();
      for (const each of afterwards) await each();
    }
  }
  return { passed, failed };
}

Object.assign(globalThis, { run, setImmediate: (call: () => void) => own.setTimeout(call, 0) });

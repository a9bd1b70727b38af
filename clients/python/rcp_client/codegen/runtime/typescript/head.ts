// Typed client of the gateway at URL, written by `rcpctl codegen --lang typescript`.
//
//   const robot = new Rcp("URL", token);
//   const value = await robot.read(path);

/** A number; those that JSON cannot write come as text. */
export type Float = number | "NaN" | "Infinity" | "-Infinity";

/** An integer; one beyond ±(2^53−1) comes and goes as its digits: `BigInt` takes both. */
export type Integer = number | `${bigint}`;

/** Bytes in base64. */
export type Base64 = string;

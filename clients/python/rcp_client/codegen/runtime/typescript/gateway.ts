/** All of it, for the package `rcp-client`: `new Client<Gateway>({ url, token })`. */
export interface Gateway {
  values: Values;
  writes: Writes;
  commands: Commands;
}

// A certified OpenID provider on loopback. It prints its address; each line on its input is a configuration, with
// which it begins anew at the same address, and is answered with a line.
import { createServer } from "node:http";
import { createInterface } from "node:readline";

import { Provider } from "oidc-provider";

const server = createServer((request, response) => answer(request, response));
let answer = (_, response) => response.writeHead(503).end();
await new Promise((done) => server.listen(0, "127.0.0.1", done));
const url = `http://127.0.0.1:${server.address().port}`;
console.log(JSON.stringify({ url }));

// Asks for the password of a person, and not for their consent: the client is of the same house.
async function loadExistingGrant({ oidc }) {
  const grant = new oidc.provider.Grant({ clientId: oidc.client.clientId, accountId: oidc.session.accountId });
  grant.addOIDCScope("openid profile");
  await grant.save();
  return grant;
}

for await (const line of createInterface({ input: process.stdin })) {
  const { client, keys, people } = JSON.parse(line);
  const provider = new Provider(url, {
    clients: [client],
    jwks: { keys },
    claims: { openid: ["sub"], profile: ["groups"] },
    conformIdTokenClaims: false,
    cookies: { keys: ["of-this-test"] },
    features: { devInteractions: { enabled: true }, rpInitiatedLogout: { enabled: true } },
    findAccount: (_, id) => ({ accountId: id, claims: () => ({ sub: id, groups: people[id] ?? [] }) }),
    loadExistingGrant,
  });
  answer = provider.callback();
  console.log("{}");
}
process.exit(0);

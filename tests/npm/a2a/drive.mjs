// Drives a rover with the protocol's own JavaScript client over one binding; prints what it saw.
import { readFileSync } from 'node:fs'
import { verifyAgentCardSignature } from '@a2a-js/sdk'
import {
  ClientFactory,
  DefaultAgentCardResolver,
  JsonRpcTransportFactory,
  RestTransportFactory,
} from '@a2a-js/sdk/client'

const { url, binding, hook, keys } = JSON.parse(readFileSync(0, 'utf8'))
const states = ['UNSPECIFIED', 'SUBMITTED', 'WORKING', 'COMPLETED', 'FAILED', 'CANCELED', 'INPUT_REQUIRED', 'REJECTED']

async function clientOf(key) {
  const fetchImpl = (where, init = {}) => {
    const headers = new Headers(init.headers)
    headers.set('authorization', `Bearer ${key}`)
    return fetch(where, { ...init, headers })
  }
  const transports = [new JsonRpcTransportFactory({ fetchImpl }), new RestTransportFactory({ fetchImpl })]
  const factory = new ClientFactory({
    transports,
    preferredTransports: [binding],
    cardResolver: new DefaultAgentCardResolver({ fetchImpl }),
  })
  return factory.createFromUrl(url)
}

const part = (kind, value) => ({ content: { $case: kind, value }, metadata: undefined, filename: '', mediaType: '' })
const said = (one, more = {}, configuration = undefined) => ({
  tenant: '',
  message: {
    messageId: crypto.randomUUID(), contextId: '', taskId: '', role: 1, parts: [one],
    metadata: undefined, extensions: [], referenceTaskIds: [], ...more,
  },
  configuration,
  metadata: undefined,
})
const text = (value, more) => said(part('text', value), more)
const move = (x, more = {}) => ({
  do: 'execute', path: '/action/move_to', value: { position: { x, y: 0 }, ...more },
})
const plan = (steps, configuration) => said(part('data', { steps }), {}, configuration)
const stateOf = (event) =>
  ['task', 'statusUpdate'].includes(event.payload?.$case) ? states[event.payload.value.status.state] : null

async function until(stream, state) {
  const seen = []
  for await (const event of stream) {
    seen.push(event)
    if (stateOf(event) === state) return seen
  }
  throw new Error(`no ${state} in ${JSON.stringify(seen)}`)
}
const idOf = (seen) => seen[0].payload.value.id
const refused = async (work) => {
  try {
    await work()
    return null
  } catch (error) {
    return error.constructor.name
  }
}

const client = await clientOf(keys.operator)
const report = { binding: client.transport.protocolName }

report.skills = (await client.getAgentCard()).skills.map((skill) => skill.id)
const verify = verifyAgentCardSignature(async (kid, jku) => {
  const { keys: known } = await (await fetch(jku)).json()
  return known.find((one) => one.kid === kid)
})
// As it came: what the resolver makes of it has lost the schemes by the time it is verified.
console.debug = () => {} // it would stand in the report
const card = await (await fetch(`${url}/.well-known/agent-card.json`)).json()
report.signed = await verify(card).then(() => true)
report.forged = await refused(() => verify({ ...card, description: 'another' })) !== null

const driven = await until(client.sendMessageStream(plan([move(0.4)])), 'COMPLETED')
report.artifacts = driven
  .filter((event) => event.payload.$case === 'artifactUpdate')
  .map((event) => event.payload.value.artifact.artifactId)
report.kept = (await client.getTask({ tenant: '', id: idOf(driven) })).artifacts.length

const cut = new AbortController()
const stream = client.sendMessageStream(plan([move(9, { speed: 0.1 })]), { signal: cut.signal })
const begun = await until(stream, 'WORKING')
cut.abort()
const again = client.resubscribeTask({ tenant: '', id: idOf(begun) })
const first = (await again.next()).value
report.resubscribed = stateOf(first)
const cancelled = await client.cancelTask({ tenant: '', id: idOf(begun), metadata: undefined })
report.cancelled = states[cancelled.status.state]
report.streamEnded = stateOf((await until(again, 'CANCELED')).at(-1))

const asked = await client.sendMessage(text('execute /action/move_to {"position": {"x": 0.4}}'))
report.asked = states[asked.status.state]
const given = said(part('data', { position: { y: 0.1 } }), { taskId: asked.id })
report.given = states[(await client.sendMessage(given)).status.state]

const careful = await clientOf(keys.careful)
const wants = await careful.sendMessage(text('execute /action/dock'))
report.approval = states[wants.status.state]
report.approved = states[(await careful.sendMessage(text('approve', { taskId: wants.id }))).status.state]

const push = { tenant: '', id: '', taskId: '', url: hook, token: binding, authentication: undefined }
const configuration = { acceptedOutputModes: [], taskPushNotificationConfig: push, returnImmediately: false }
const pushed = await client.sendMessage(plan([move(0.1)], configuration))
report.pushed = states[pushed.status.state]

const other = await clientOf(keys.beta)
report.hidden = await refused(() => other.getTask({ tenant: '', id: asked.id }))
report.denied = states[(await other.sendMessage(text('execute /tenant/alpha/action/dock'))).status.state]
report.stranger = await refused(async () => (await clientOf('nobody-knows-this-key')).listTasks({ tenant: '' }))

console.log(JSON.stringify(report))

// A page made with roslib that offers a service and an action, and another one that calls them.
//
// node offers.mjs URL: prints one line of JSON.

import { once } from 'node:events';
import * as ROSLIB from 'roslib';

const [url] = process.argv.slice(2);
const found = {};
const BOUND = 60_000;
const SET = '/page/set_it';
const LATER = '/page/set_later';
const COUNT = '/page/count_up';

function within(promise, what) {
  const late = new Promise((_, no) => setTimeout(() => no(new Error(`late: ${what}`)), BOUND).unref());
  return Promise.race([promise, late]);
}

function asked(call, what) {
  return within(new Promise((yes, no) => call(yes, no)), what);
}

async function connected() {
  const ros = new ROSLIB.Ros({});
  ros.on('error', () => {});
  const connection = once(ros, 'connection');
  ros.connect(url);
  await within(connection, 'connection');
  return ros;
}

async function until(look, what) {
  const end = Date.now() + BOUND;
  while (!(await look())) {
    if (Date.now() > end) throw new Error(`late: ${what}`);
  }
}

const provider = await connected();
const caller = await connected();

const type = 'std_srvs/srv/SetBool';
const offered = new ROSLIB.Service({ ros: provider, name: SET, serviceType: type });
const later = new ROSLIB.Service({ ros: provider, name: LATER, serviceType: type });
await offered.advertise((request, response) => {
  response.success = request.data;
  response.message = `set to ${request.data}`;
  return true;
});
await later.advertiseAsync(async (request) => ({ success: !request.data, message: 'later' }));

const facts = { name: COUNT, actionType: 'test_msgs/action/Fibonacci' };
const action = new ROSLIB.Action({ ros: provider, ...facts });
action.advertise(
  (goal, id) => {
    action.sendFeedback(id, { sequence: [0] });
    if (goal.order === 3) action.setSucceeded(id, { sequence: [0, 1, 1] });
    if (goal.order === 4) action.setFailed(id);
  },
  (id) => action.setCanceled(id, { sequence: [0] }),
);
const services = () => asked((yes, no) => caller.getServices(yes, no), 'services');
const actions = () => asked((yes, no) => caller.getActionServers(yes, no), 'actions');
await until(async () => (await services()).includes(SET), SET);
await until(async () => (await services()).includes(LATER), LATER);
await until(async () => (await actions()).includes(COUNT), COUNT);

function call(name, request) {
  const called = new ROSLIB.Service({ ros: caller, name, serviceType: type });
  return asked((yes, no) => called.callService(request, yes, no), name);
}

found.set = await call(SET, { data: true });
found.later = await call(LATER, { data: false });
await offered.unadvertise();

const goal = new ROSLIB.Action({ ros: caller, ...facts });
const fed = [];
found.counted = await asked(
  (yes, no) => goal.sendGoal({ order: 3 }, yes, (one) => fed.push(one.sequence), no),
  'result',
);
found.fed = fed;
found.failed = String(await asked((yes) => goal.sendGoal({ order: 4 }, yes, () => {}, yes), 'failed'));
found.cancelled = await asked((yes) => {
  const id = goal.sendGoal({ order: 9 }, () => yes('result'), () => goal.cancelGoal(id), () => yes('ended'));
}, 'cancelled');

await until(async () => !(await services()).includes(SET), 'unadvertised');
console.log(JSON.stringify(found));
process.exit(0);

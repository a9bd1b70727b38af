// Two tabs of a page made with roslib: one offers a service and an action, the other calls them. When
// the gateway is killed, both connect again, and everything works as before.
//
// node tabs.mjs URL TOKEN: prints "ready" when it may be killed, then one line of JSON.

import * as ROSLIB from 'roslib';

const [url, token] = process.argv.slice(2);
const BOUND = 60_000;
const RESTART = 180_000; // a gateway starts meanwhile, beside all else that the machine does

function within(promise, what, bound = BOUND) {
  const late = new Promise((_, no) => setTimeout(() => no(new Error(`late: ${what}`)), bound).unref());
  return Promise.race([promise, late]);
}

function event(ros, name) {
  return new Promise((resolve) => ros.once(name, resolve));
}

function asked(call, what) {
  return within(new Promise((yes, no) => call(yes, no)), what);
}

async function tab() {
  const ros = new ROSLIB.Ros({});
  ros.on('error', () => {});
  ros.on('connection', () => ros.authenticate(token, 'page', 'robot', 'r', 1, 'user', 2));
  ros.on('close', () => setTimeout(() => ros.connect(url).catch(() => {}), 100));
  const connected = event(ros, 'connection');
  ros.connect(url);
  await within(connected, 'connection');
  return ros;
}

const [provider, caller] = [await tab(), await tab()];
const odom = new ROSLIB.Topic({ ros: caller, name: '/odom', messageType: 'nav_msgs/Odometry' });
let heard;
odom.subscribe(() => heard?.());

function offer() {
  const add = new ROSLIB.Service({ ros: provider, name: '/add', serviceType: 'my_msgs/srv/Add' });
  add.advertise((request, response) => {
    response.sum = request.a + request.b;
    return request.a >= 0;
  });
  const count = new ROSLIB.Action({ ros: provider, name: '/count', actionType: 'my_msgs/action/Count' });
  const goals = new Map();
  count.advertise((goal, id) => {
    goals.set(id, goal);
    count.sendFeedback(id, { at: 1 });
    if (goal.fails) count.setFailed(id);
    else if (goal.to < 10) count.setSucceeded(id, { at: goal.to });
  }, (id) => count.setCanceled(id, { at: 1 }));
}

async function until(service) {
  await within((async () => {
    while (!(await asked((yes, no) => caller.getServices(yes, no), 'services')).includes(service));
  })(), service);
}

async function work() {
  await within(new Promise((resolve) => { heard = resolve; }), 'odometry');
  await until('/add');
  const add = new ROSLIB.Service({ ros: caller, name: '/add', serviceType: 'my_msgs/srv/Add' });
  const sum = (await asked((yes, no) => add.callService({ a: 1, b: 2 }, yes, no), 'sum')).sum;
  const wrong = await asked((yes, no) => add.callService({ a: -1, b: 2 }, no, yes), 'failure');
  const count = new ROSLIB.Action({ ros: caller, name: '/count', actionType: 'my_msgs/action/Count' });
  let feedback;
  const result = await asked((yes, no) => {
    count.sendGoal({ to: 3 }, yes, (message) => { feedback = message; }, no);
  }, 'result');
  const failed = await asked((yes, no) => count.sendGoal({ fails: true }, no, () => {}, yes), 'failed');
  const cancelled = await asked((yes) => {
    const id = count.sendGoal({ to: 99 }, yes, () => count.cancelGoal(id), yes);
  }, 'cancelled');
  return { sum, wrong, feedback, result, failed, cancelled: cancelled !== undefined };
}

offer();
const before = await work();
const gone = Promise.all([event(provider, 'close'), event(caller, 'close')]);
const back = Promise.all([event(provider, 'connection'), event(caller, 'connection')]);
console.log('ready');
await within(gone, 'close');
await within(back, 'connection again', RESTART);
offer();
console.log(JSON.stringify({ before, after: await work() }));
process.exit(0);

// A page made with roslib for any rosbridge: drives a base, and uses every operation that roslib has.
//
// node page.mjs URL TOKEN FACTS: prints one line of JSON. FACTS says what the robot has.

import { once } from 'node:events';
import * as ROSLIB from 'roslib';

const [url, token, text] = process.argv.slice(2);
const facts = JSON.parse(text);
const found = {};
const BOUND = 60_000;

function within(promise, what) {
  const late = new Promise((_, no) => setTimeout(() => no(new Error(`late: ${what}`)), BOUND).unref());
  return Promise.race([promise, late]);
}

function asked(call, what) {
  return within(new Promise((yes, no) => call(yes, no)), what);
}

const ros = new ROSLIB.Ros({});
ros.on('error', () => {});
const connected = once(ros, 'connection');
ros.connect(url);
await within(connected, 'connection');
if (token) ros.authenticate(token, 'page', 'robot', 'r', 1, 'user', 2);

function topic(name, messageType, more = {}) {
  return new ROSLIB.Topic({ ros, name, messageType, ...more });
}

function next(of, wanted = () => true) {
  const { promise, resolve } = Promise.withResolvers();
  const listener = (message) => {
    if (wanted(message)) {
      of.unsubscribe(listener);
      resolve(message);
    }
  };
  of.subscribe(listener);
  return within(promise, of.name);
}

const topics = await asked((yes, no) => ros.getTopics(yes, no), 'topics');
found.odom_type = topics.types[topics.topics.indexOf(facts.odom)];
found.cmd_vel_type = topics.types[topics.topics.indexOf(facts.cmd_vel)];
found.nodes = await asked((yes, no) => ros.getNodes(yes, no), 'nodes');
found.services = await asked((yes, no) => ros.getServices(yes, no), 'services');
found.actions = await asked((yes, no) => ros.getActionServers(yes, no), 'actions');
found.params = await asked((yes, no) => ros.getParams(yes, no), 'params');
found.topic_type = await asked((yes, no) => ros.getTopicType(facts.odom, yes, no), 'topic type');
found.service_type = await asked((yes, no) => ros.getServiceType(facts.trigger, yes, no), 'service type');
found.for_type = await asked((yes, no) => ros.getTopicsForType('nav_msgs/msg/Odometry', yes, no), 'for type');
const details = await asked((yes, no) => ros.getMessageDetails('nav_msgs/Odometry', yes, no), 'details');
found.details = ros.decodeTypeDefs(details);
const raw = await asked((yes, no) => ros.getTopicsAndRawTypes(yes, no), 'raw types');
found.raw = raw.typedefs_full_text[raw.topics.indexOf(facts.odom)].split('\n').length;

const cmdVel = topic(facts.cmd_vel, 'geometry_msgs/Twist');
cmdVel.advertise();
const odom = topic(facts.odom, 'nav_msgs/Odometry', { throttle_rate: 20, queue_length: 1 });
const forward = { linear: { x: 0.3, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } };
const driving = setInterval(() => cmdVel.publish(forward), 50);
const moving = await next(odom, (m) => m.twist.twist.linear.x > 0.1);
clearInterval(driving);
found.speed = moving.twist.twist.linear.x;
found.stamp = moving.header.stamp;
if (facts.stops) {
  await next(odom, (m) => Math.abs(m.twist.twist.linear.x) < 0.02);
  found.stopped = true;
}
cmdVel.unadvertise();

for (const compression of ['png', 'cbor', 'cbor-raw']) {
  // What was on its way in the form before may still come.
  const field = compression === 'cbor-raw' ? 'bytes' : 'pose';
  const message = await next(topic(facts.odom, 'nav_msgs/Odometry', { compression }), (m) => m[field]);
  found[compression] = compression === 'cbor-raw'
    ? new Uint8Array(message.bytes).length
    : message.pose.pose.orientation.w;
}
const typed = await next(topic(facts.odom, 'nav_msgs/Odometry', { compression: 'cbor' }), (m) => m.pose);
found.covariance = `${typed.pose.covariance.constructor.name} ${typed.pose.covariance.length}`;
if (facts.long) {
  const { promise, resolve } = Promise.withResolvers();
  ros.on(facts.long[0], resolve);
  ros.callOnConnection({ op: 'subscribe', topic: facts.long[0], fragment_size: 500 });
  await within(promise, 'fragments');
  found.fragments = true;
}

const trigger = new ROSLIB.Service({ ros, name: facts.trigger, serviceType: 'std_srvs/Trigger' });
found.trigger = await asked((yes, no) => trigger.callService({}, yes, no), 'trigger');
const missing = new ROSLIB.Service({ ros, name: '/no_such', serviceType: 'std_srvs/Trigger' });
found.missing = await asked((yes) => missing.callService({}, yes, yes), 'missing');

if (facts.param) {
  const param = new ROSLIB.Param({ ros, name: facts.param });
  await asked((yes, no) => param.set(facts.value, yes, no), 'set');
  found.param = await asked((yes, no) => param.get(yes, no), 'get');
}

if (facts.action) {
  const action = new ROSLIB.Action({ ros, name: facts.action.name, actionType: facts.action.type });
  let feedback = 0;
  found.result = await asked(
    (yes, no) => action.sendGoal(facts.action.goal, yes, () => { feedback += 1; }, no),
    'result',
  );
  found.feedback = feedback;
  const { promise, resolve } = Promise.withResolvers();
  const id = action.sendGoal(facts.action.far, resolve, () => action.cancelGoal(id), resolve);
  found.cancelled = String(await within(promise, 'cancelled')).length > 0;
}

console.log(JSON.stringify(found));
ros.close();
process.exit(0);

// A client of MQTT.js: node requests.mjs PORT. Reads a retained state, and requests a state and a refused motion.

import { createRequire } from 'node:module';
import path from 'node:path';

const require = createRequire(path.join(process.cwd(), 'package.json'));
const mqtt = require('mqtt');

const ANSWERS = 'answers/mqttjs';
const client = await mqtt.connectAsync(`mqtt://127.0.0.1:${process.argv[2]}`, { protocolVersion: 5 });
const messages = [];
const waiting = [];
client.on('message', (topic, payload, packet) => {
    messages.push({ topic, text: payload.toString(), properties: packet.properties ?? {} });
    for (const look of [...waiting]) look();
});

/** Waits for a message that is accepted. */
function next(accepts) {
    return new Promise((resolve, reject) => {
        const timer = setTimeout(() => reject(new Error('no message within 30 s')), 30000);
        const look = () => {
            const found = messages.find(accepts);
            if (found === undefined) return;
            clearTimeout(timer);
            waiting.splice(waiting.indexOf(look), 1);
            resolve(found);
        };
        waiting.push(look);
        look();
    });
}

async function ask(topic, body) {
    const properties = { responseTopic: ANSWERS, correlationData: Buffer.from(topic) };
    await client.publishAsync(`wsg/cell/${topic}`, JSON.stringify(body), { qos: 1, properties });
    const answer = await next((message) => message.properties.correlationData?.toString() === topic);
    return { status: answer.properties.userProperties.status, body: JSON.parse(answer.text) };
}

function check(condition, what) {
    if (!condition) throw new Error(what);
}

await client.subscribeAsync([ANSWERS, 'wsg/cell/g0/state'], { qos: 1 });
const state = await next((message) => message.topic === 'wsg/cell/g0/state');
check(JSON.parse(state.text).gripper === 'g0', state.text);
const read = await ask('g0/command/state', {});
check(read.status === '200' && read.body.link === 'connected', JSON.stringify(read));
const refused = await ask('g0/command/grip', { width_mm: 500, speed_mm_s: 200 });
check(refused.status === '422' && refused.body.code === 'out_of_range', JSON.stringify(refused));
await client.endAsync();
console.log('MQTT.js: retained state, requests and refusals');

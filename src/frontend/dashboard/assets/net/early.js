// Begins the connection while the modules are still on their way: one round trip less until there is something to see.

globalThis.earlySocket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/api/v1/ws`, 'wsg.v1');

//! Clients over HTTP and WebSocket: their rights, their requests, and protocols that are not HTTP.

mod access;
mod bodies;
mod foreign_protocols;
mod host_and_origin;
mod websocket;
mod websocket_stops;

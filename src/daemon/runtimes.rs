//! The runtimes: one for the devices and several for clients, each with threads of its own.

use std::io;

use tokio::runtime::{Builder, Handle, Runtime};

use crate::connections::Runtimes;

/// Niceness of the observers' thread (`nice`, 0 to 19): enough that the kernel prefers any other thread.
const NICE: i32 = 10;

/// Tasks that a thread runs before it looks for new events, such as a FAST STOP. Tokio's default is 61.
const EVENT_INTERVAL: u32 = 16;

/// All runtimes. They end with the process.
pub(super) struct Owned {
    /// The device side has a runtime of its own, so that no number of clients delays a FAST STOP.
    pub(super) devices: Runtime,
    pub(super) requests: Runtime,
    accept: Runtime,
    sockets: Runtime,
    observers: Runtime,
    publications: Runtime,
    /// `None` without Modbus.
    modbus: Option<Runtime>,
}

impl Owned {
    pub(super) fn start(has_modbus: bool) -> io::Result<Self> {
        Ok(Self {
            devices: single("device").build()?,
            requests: Builder::new_multi_thread().event_interval(EVENT_INTERVAL).enable_all().build()?,
            // One thread accepts connections while the other inspects those that have come.
            accept: single("accept").worker_threads(2).build()?,
            sockets: single("sockets").event_interval(EVENT_INTERVAL).build()?,
            // Updates for a thousand observers must not delay a request.
            observers: single("observers").on_thread_start(yield_to_others).build()?,
            // Zenoh has sockets of its own, so this runtime needs no descriptors for any.
            publications: thread("publications").enable_time().on_thread_start(yield_to_others).build()?,
            modbus: has_modbus.then(|| single("modbus").event_interval(EVENT_INTERVAL).build()).transpose()?,
        })
    }

    /// The runtime of Modbus, if it is configured.
    pub(super) fn modbus(&self) -> Option<&Handle> {
        self.modbus.as_ref().map(Runtime::handle)
    }

    pub(super) fn of_clients(&self) -> Runtimes {
        Runtimes {
            accept: self.accept.handle().clone(),
            requests: self.requests.handle().clone(),
            sockets: self.sockets.handle().clone(),
            observers: self.observers.handle().clone(),
            publications: self.publications.handle().clone(),
        }
    }

    pub(super) fn end(self) {
        let clients = [self.publications, self.observers, self.sockets, self.accept, self.requests];
        for runtime in clients.into_iter().chain(self.modbus).chain([self.devices]) {
            runtime.shutdown_background();
        }
    }
}

fn single(name: &str) -> Builder {
    let mut builder = thread(name);
    builder.enable_all();
    builder
}

/// A runtime of one thread, without timers and sockets yet.
fn thread(name: &str) -> Builder {
    let mut builder = Builder::new_multi_thread();
    builder.worker_threads(1).thread_name(name);
    builder
}

fn yield_to_others() {
    // On a system without such priorities, the thread keeps its own.
    let _ = rustix::process::setpriority_process(None, NICE);
}

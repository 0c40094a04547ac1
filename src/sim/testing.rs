//! Test bench: a device on a virtual clock, with a client's requests and replies.

use std::time::{Duration, Instant};

use wsg::{
    ChecksumEvaluation, Command, Data, Decoded, Decoder, GripperState, HomingDirection, LoopData, MoveFlags, Reply,
    Speed, Status, SystemState, Updates, Width, id,
};

use super::{Change, Device, DeviceConfig, FaultKind, FaultName, Interface, Snapshot};

pub struct Bench {
    pub device: Device,
    pub now: Instant,
    pub decoder: Decoder,
    /// Longest time between two calls of the device.
    pub stride: Duration,
}

pub fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

pub fn status(code: Status) -> Reply {
    Reply::Status(code)
}

pub const DONE: Reply = Reply::Success(Data::None);
pub const PENDING: Reply = Reply::Status(Status::E_CMD_PENDING);

impl Bench {
    /// Creates a device with a client on TCP.
    pub fn new(config: DeviceConfig) -> Self {
        Self::on(config, Interface::Tcp)
    }

    pub fn on(config: DeviceConfig, interface: Interface) -> Self {
        let now = Instant::now();
        let mut device = Device::new(config, now);
        assert!(device.connect(now, interface));
        let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        Self { device, now, decoder, stride: ms(1) }
    }

    /// Creates a homed device, with its fingers 1 mm from the outer end stop.
    pub fn homed(config: DeviceConfig) -> Self {
        let mut bench = Self::new(config);
        bench.home();
        bench
    }

    pub fn home(&mut self) {
        assert_eq!(self.run(&Command::Homing(HomingDirection::Default)), [PENDING, DONE]);
    }

    /// Sends a request, and returns the immediate frames.
    pub fn ask(&mut self, command: &Command) -> Vec<(u8, Reply)> {
        let mut bytes = Vec::new();
        command.encode(&mut bytes);
        self.device.receive(self.now, &bytes);
        self.frames()
    }

    /// Sends a possibly invalid request, and returns the immediate frames.
    pub fn ask_raw(&mut self, id: u8, payload: &[u8]) -> Vec<(u8, Reply)> {
        let mut bytes = Vec::new();
        wsg::frame::encode(id, payload, &mut bytes);
        self.device.receive(self.now, &bytes);
        self.frames()
    }

    /// Sends a one-step request, and returns its only reply.
    pub fn reply(&mut self, command: &Command) -> Reply {
        let frames = self.ask(command);
        assert_eq!(frames.len(), 1, "{frames:?}");
        assert_eq!(frames[0].0, command.id());
        frames[0].1.clone()
    }

    pub fn status_of_raw(&mut self, id: u8, payload: &[u8]) -> Status {
        let frames = self.ask_raw(id, payload);
        assert_eq!(frames.len(), 1, "{frames:?}");
        assert_eq!(frames[0].0, id);
        frames[0].1.status()
    }

    /// Runs a motion to its end, and returns its replies.
    pub fn run(&mut self, command: &Command) -> Vec<Reply> {
        let mut frames = self.ask(command);
        frames.extend(self.pass(ms(8000)));
        frames.into_iter().filter(|(id, _)| *id == command.id()).map(|(_, reply)| reply).collect()
    }

    /// Advances time, and returns the frames sent meanwhile.
    pub fn pass(&mut self, time: Duration) -> Vec<(u8, Reply)> {
        let end = self.now + time;
        let mut frames = Vec::new();
        while self.now < end {
            self.now = (self.now + self.stride).min(end);
            self.device.handle_timeout(self.now);
            frames.extend(self.frames());
        }
        frames
    }

    pub fn chunks(&mut self) -> Vec<Vec<u8>> {
        let mut chunks = Vec::new();
        loop {
            let mut chunk = Vec::new();
            if !self.device.poll_transmit(&mut chunk) {
                return chunks;
            }
            chunks.push(chunk);
        }
    }

    pub fn frames(&mut self) -> Vec<(u8, Reply)> {
        for chunk in self.chunks() {
            self.decoder.push(&chunk);
        }
        let mut frames = Vec::new();
        while let Some(decoded) = self.decoder.next() {
            if let Decoded::Frame(frame) = decoded {
                frames.push((frame.id, Reply::parse(frame.id, frame.payload).unwrap()));
            }
        }
        frames
    }

    pub fn apply(&mut self, change: Change) {
        self.device.apply(self.now, change);
    }

    pub fn arm(&mut self, kind: FaultKind, id: u8) {
        self.apply(Change::Fault { kind, id: Some(id), times: 1 });
    }

    pub fn happened(&self, name: FaultName) -> u64 {
        self.device.fault_counts().of(name)
    }

    pub fn snapshot(&self) -> Snapshot {
        self.device.snapshot()
    }

    pub fn state(&self) -> GripperState {
        self.snapshot().gripper_state
    }

    pub fn has(&self, flags: SystemState) -> bool {
        self.snapshot().flags.contains(flags)
    }

    pub fn has_any(&self, flags: SystemState) -> bool {
        self.snapshot().flags.intersects(flags)
    }
}

pub fn width(mm: f32) -> Width {
    Width::new(mm).unwrap()
}

pub fn speed(mm_s: f32) -> Speed {
    Speed::new(mm_s).unwrap()
}

pub fn move_to(mm: f32, mm_s: f32) -> Command {
    let flags = MoveFlags { relative: false, stop_on_block: true };
    Command::PrePosition { flags, width: width(mm), speed: speed(mm_s) }
}

pub fn clamp_to(mm: f32, mm_s: f32) -> Command {
    let flags = MoveFlags { relative: false, stop_on_block: false };
    Command::PrePosition { flags, width: width(mm), speed: speed(mm_s) }
}

pub fn move_by(mm: f32, mm_s: f32) -> Command {
    let flags = MoveFlags { relative: true, stop_on_block: true };
    Command::PrePosition { flags, width: width(mm), speed: speed(mm_s) }
}

pub fn grip(mm: f32, mm_s: f32) -> Command {
    Command::Grip { width: width(mm), speed: speed(mm_s) }
}

pub fn release(mm: f32, mm_s: f32) -> Command {
    Command::Release { width: width(mm), speed: speed(mm_s) }
}

pub fn looped(bytes: &[u8]) -> Command {
    Command::Loop(LoopData::new(bytes.to_vec()).unwrap())
}

pub fn updates(on_change: bool, period_ms: u16) -> Updates {
    Updates::On { on_change, period_ms }
}

pub fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 0.02
}

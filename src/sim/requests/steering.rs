//! Scripts that steer the fingers: they take targets many times a second, one request a period. The public scripts go on
//! with the last target when no further one comes. The script of `deploy/device` stops.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use wsg::{CustomCommand, Data, Force, Reply, Status};

use super::super::Device;
use super::super::config::{FingerConfig, SteeringConfig, SteeringScript};
use super::super::motion::axis::{AxisDirection, Drive};
use super::replies::PendingReply;

/// Ids of the public scripts: state, target, speed.
const READ: u8 = 0xB0;
const TARGET: u8 = 0xB1;
const SPEED: u8 = 0xB2;

/// Id of the script with a watchdog.
const WATCHDOG: u8 = 0xB4;

/// Limit of requests that wait for the script; further ones are lost.
const MAX_WAITING_REQUESTS: usize = 128;

/// Time without a target after which the script with a watchdog stops the fingers.
const SILENCE: Duration = Duration::from_millis(200);

/// Pause of the public scripts after a request that they cannot read. They do not answer it.
const PAUSE_AFTER_ERROR: Duration = Duration::from_millis(100);

/// Bit of the reply of the script with a watchdog: it has stopped the fingers since the target before.
const STOPPED_BY_WATCHDOG: u8 = 1;

impl SteeringConfig {
    pub(crate) fn takes(&self, id: u8) -> bool {
        match self.script {
            None => false,
            Some(SteeringScript::Pd) => matches!(id, READ | TARGET),
            Some(SteeringScript::Width) => matches!(id, READ | TARGET | SPEED),
            Some(SteeringScript::Watchdog) => id == WATCHDOG,
        }
    }
}

/// A request that waits for the script.
#[derive(Debug)]
struct Waiting {
    ticket: PendingReply,
    payload: Vec<u8>,
    ready_at: Instant,
}

/// State of the script.
#[derive(Debug)]
pub(crate) struct Steering {
    waiting: VecDeque<Waiting>,
    free_at: Instant,
    /// Zero of the script's clock.
    started_at: Instant,
    /// Time at which the watchdog stops the fingers.
    pub silent_at: Option<Instant>,
    was_silent: bool,
}

impl Steering {
    pub fn new(now: Instant) -> Self {
        Self { waiting: VecDeque::new(), free_at: now, started_at: now, silent_at: None, was_silent: false }
    }

    /// Time at which the script takes the next request.
    pub fn due(&self) -> Option<Instant> {
        self.waiting.front().map(|request| request.ready_at.max(self.free_at))
    }

    /// Forgets the requests, because their client or the script has ended.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}

/// What a request asks for. All values are finite.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Target {
    /// Nothing: the request only reads.
    Read,
    /// A width that has to be within the soft limits.
    Width {
        width_mm: f64,
        speed_mm_s: f64,
    },
    /// A width that the script leads the fingers to by their speed, whatever the soft limits are.
    Approach {
        width_mm: f64,
        speed_mm_s: f64,
    },
    Speed {
        mm_s: f64,
    },
    Pd(Pd),
}

/// Target of the script with gains.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pd {
    position_mm: f64,
    speed_mm_s: f64,
    kp: f64,
    kd: f64,
    /// Force limits while the fingers travel, and while they are blocked.
    travel_n: f64,
    blocked_n: f64,
}

impl Target {
    /// Reads a request. Surplus bytes are ignored, as the scripts do. The public scripts ignore the first byte.
    fn parse(script: SteeringScript, id: u8, payload: &[u8]) -> Option<Self> {
        match (script, id) {
            (SteeringScript::Watchdog, _) if payload.is_empty() => Some(Self::Read),
            (SteeringScript::Watchdog, _) => {
                let [width_mm, speed_mm_s] = floats(payload)?;
                Some(Self::Approach { width_mm, speed_mm_s: speed_mm_s.abs() })
            }
            (_, READ) => Some(Self::Read),
            (SteeringScript::Pd, _) => {
                let [position_mm, speed_mm_s, kp, kd, travel_n, blocked_n] = floats(payload.get(1..)?)?;
                Some(Self::Pd(Pd { position_mm, speed_mm_s, kp, kd, travel_n, blocked_n }))
            }
            (SteeringScript::Width, SPEED) => {
                let [_, mm_s] = floats(payload.get(1..)?)?;
                Some(Self::Speed { mm_s })
            }
            (SteeringScript::Width, _) => {
                let [width_mm, speed_mm_s] = floats(payload.get(1..)?)?;
                Some(Self::Width { width_mm, speed_mm_s: speed_mm_s.abs() })
            }
        }
    }
}

/// Reads finite floats from the beginning of `bytes`.
fn floats<const N: usize>(bytes: &[u8]) -> Option<[f64; N]> {
    let mut values = [0.0; N];
    for (index, value) in values.iter_mut().enumerate() {
        let bytes = bytes.get(index * 4..index * 4 + 4)?;
        *value = f64::from(f32::from_le_bytes(bytes.try_into().ok()?));
    }
    values.iter().all(|value| value.is_finite()).then_some(values)
}

impl Device {
    /// Hands a request to the script.
    pub(crate) fn steering_request(&mut self, command: &CustomCommand) {
        if self.steering.waiting.len() >= MAX_WAITING_REQUESTS {
            self.refused_requests += 1;
            return;
        }
        let ticket = self.ticket(command.id());
        let ready_at = self.clock + self.config.steering.delay;
        self.steering.waiting.push_back(Waiting { ticket, payload: command.payload().to_vec(), ready_at });
    }

    /// Performs the oldest request.
    pub(crate) fn run_steering(&mut self) {
        let Some(script) = self.config.steering.script else { return };
        let Some(request) = self.steering.waiting.pop_front() else { return };
        self.steering.free_at = self.clock + self.config.steering.period;
        let target = Target::parse(script, request.ticket.id, &request.payload);
        if script == SteeringScript::Watchdog {
            return self.run_with_watchdog(request.ticket, target);
        }
        let Some(target) = target else {
            self.steering.free_at = self.clock + PAUSE_AFTER_ERROR;
            return;
        };
        // A public script answers with the state, whether the fingers move or not.
        let _ = self.steer(target);
        let bytes = self.state_of_script(script);
        self.result(request.ticket, Reply::Success(Data::Custom(bytes)));
    }

    fn run_with_watchdog(&mut self, ticket: PendingReply, target: Option<Target>) {
        let done = target.ok_or(Status::E_CMD_FORMAT_ERROR).and_then(|target| self.steer(target));
        if let Err(status) = done {
            return self.result_status(ticket, status);
        }
        let mut bytes = bytes_of([self.shown_width_mm(), self.shown_force_n()]);
        bytes.push(self.flags().bits() as u8);
        bytes.push(if self.steering.was_silent { STOPPED_BY_WATCHDOG } else { 0 });
        if target != Some(Target::Read) {
            self.steering.silent_at = Some(self.clock + SILENCE);
            self.steering.was_silent = false;
        }
        self.result(ticket, Reply::Success(Data::Custom(bytes)));
    }

    /// Stops the fingers, because no target has come.
    pub(crate) fn stop_silent_script(&mut self) {
        self.steering.silent_at = None;
        if self.mechanics.is_steered() {
            self.steering.was_silent = true;
            self.process.axis_stopped = true;
            self.mechanics.stop(false);
        }
    }

    /// Moves the fingers towards a target, from any motion.
    fn steer(&mut self, target: Target) -> Result<(), Status> {
        if target == Target::Read {
            return Ok(());
        }
        if self.fast_stopped || self.has_fault() {
            return Err(Status::E_ACCESS_DENIED);
        }
        if !self.mechanics.referenced {
            return Err(Status::E_NOT_INITIALIZED);
        }
        if self.mechanics.is_stopping() {
            return Err(Status::E_ALREADY_RUNNING);
        }
        let drive = match target {
            Target::Read => return Ok(()),
            Target::Width { width_mm, speed_mm_s } => {
                let width_mm = self.allowed_target(width_mm)?;
                self.drive(width_mm, speed_mm_s, self.settings.force_limit_n)
            }
            Target::Approach { width_mm, speed_mm_s } => {
                let width_mm = self.config.clamp_width_mm(width_mm);
                self.drive(width_mm, speed_mm_s, self.settings.force_limit_n)
            }
            Target::Speed { mm_s } => self.drive_at(mm_s),
            Target::Pd(pd) => {
                let force_n = if self.mechanics.blocked.is_some() { pd.blocked_n } else { pd.travel_n };
                if let Ok(force) = Force::new(force_n as f32) {
                    self.settings.set_force_limit(force, &self.config);
                }
                let error_mm = pd.position_mm - self.shown_width_mm();
                let slow_mm_s = pd.speed_mm_s - self.mechanics.axis.speed_mm_s;
                self.drive_at(pd.kp * error_mm + pd.kd * slow_mm_s)
            }
        };
        self.process.steered();
        self.end_running(&[], Status::E_SUCCESS, Status::E_CMD_ABORTED);
        self.mechanics.steer(drive);
        Ok(())
    }

    /// A drive at a speed, to the end of the travel.
    fn drive_at(&self, mm_s: f64) -> Drive {
        let direction = if mm_s < 0.0 { AxisDirection::Closing } else { AxisDirection::Opening };
        Drive {
            target_mm: self.mechanics.axis.position_mm + direction.sign() * 2.0 * self.config.stroke_mm(),
            speed_mm_s: mm_s.abs().min(f64::from(self.config.limits.max_speed.mm_s())),
            acceleration_mm_s2: self.settings.acceleration_mm_s2,
            force_limit_n: self.settings.force_limit_n,
        }
    }

    /// Reply of a public script: the lowest byte of the system state flags, width, speed and force, and then the time of
    /// the script's clock in s, or the force at each finger in N.
    fn state_of_script(&self, script: SteeringScript) -> Vec<u8> {
        let mut bytes = vec![self.flags().bits() as u8];
        let measured = [self.shown_width_mm(), self.mechanics.axis.speed_mm_s, self.shown_force_n()];
        bytes.extend(bytes_of(measured));
        if script == SteeringScript::Pd {
            let time = self.clock.saturating_duration_since(self.steering.started_at);
            bytes.extend(time.as_secs_f32().to_le_bytes());
            return bytes;
        }
        for finger in &self.config.fingers {
            let force_n = if *finger == FingerConfig::Fmf { self.shown_force_n() / 2.0 } else { f64::NAN };
            bytes.extend((force_n as f32).to_le_bytes());
        }
        bytes
    }
}

fn bytes_of<const N: usize>(values: [f64; N]) -> Vec<u8> {
    values.into_iter().flat_map(|value| (value as f32).to_le_bytes()).collect()
}

#[cfg(test)]
#[path = "steering_tests.rs"]
mod tests;

//! Handling of all requests except motions.

use wsg::{
    Acceleration, Command, CustomCommand, Data, Finger, Force, InvalidRequest, Reply, Status, Temperature, Updates, id,
};

use crate::Device;
use crate::config::ScriptAnswer;
use crate::models::Generation;

impl Device {
    /// Handles a request with a correct checksum.
    pub(crate) fn request(&mut self, id: u8, command: Result<Command, InvalidRequest>) {
        if self.outbox.is_full() {
            self.refused_requests += 1;
            if id == id::FAST_STOP {
                self.fast_stop();
            }
            return;
        }
        if self.announced {
            // Until the connection ends (`fw4-en 3.1.2`).
            return self.answer_status(id, Status::E_ACCESS_DENIED);
        }
        if self.strikes_request(id) {
            return;
        }
        if !self.knows(id) {
            return self.answer_status(id, Status::E_CMD_UNKNOWN);
        }
        if id::is_motion(id) {
            return self.motion_request(id, command);
        }
        match command {
            Ok(command) => self.execute(command),
            Err(error) => self.answer_status(id, error.status()),
        }
    }

    /// Whether the device knows `id`. fw2 has no temperature and no finger interface, and script ids need a running
    /// script.
    fn knows(&self, id: u8) -> bool {
        match id {
            id::GET_TEMPERATURE
            | id::GET_FINGER_1_INFO..=id::GET_FINGER_1_DATA
            | id::GET_FINGER_2_INFO..=id::GET_FINGER_2_DATA
                if self.config.generation == Generation::Fw2 =>
            {
                false
            }
            _ if id::describe(id).is_some() => true,
            _ if !self.script_runs => false,
            _ => self.config.steering.takes(id) || self.config.scripts.iter().any(|script| script.id == id),
        }
    }

    fn execute(&mut self, command: Command) {
        let id = command.id();
        match command {
            Command::Loop(data) => self.answer_loop(data.as_bytes().to_vec()),
            Command::DisconnectAnnouncement => self.announce_disconnect(),
            Command::Stop => self.stop(),
            Command::FastStop => self.fast_stop_request(),
            Command::AcknowledgeFastStop => self.acknowledge(),
            Command::SetAcceleration(_)
            | Command::SetForceLimit(_)
            | Command::SetSoftLimits(_)
            | Command::ClearSoftLimits
            | Command::OverdriveMode { .. }
            | Command::SetDeviceTag(_) => {
                let status = self.set(command);
                self.answer_status(id, status);
            }
            Command::TareForceSensor => {
                let status = self.tare();
                self.answer_status(id, status);
            }
            Command::GetSystemState(updates)
            | Command::GetGripperState(updates)
            | Command::GetWidth(updates)
            | Command::GetSpeed(updates)
            | Command::GetForce(updates) => self.query(id, updates),
            Command::FingerPower { finger, on } => self.finger_power(id, finger, on),
            Command::Custom(custom) if self.config.steering.takes(id) => self.steering_request(&custom),
            Command::Custom(custom) => self.run_script(&custom),
            getter => match self.get(&getter) {
                Ok(data) => self.answer(id, Reply::Success(data)),
                Err(status) => self.answer_status(id, status),
            },
        }
    }

    fn set(&mut self, command: Command) -> Status {
        match command {
            Command::SetAcceleration(acceleration) => self.settings.set_acceleration(acceleration, &self.config),
            Command::SetForceLimit(force) => self.settings.set_force_limit(force, &self.config),
            Command::SetSoftLimits(limits) => self.settings.soft_limits = Some(limits),
            Command::ClearSoftLimits => self.settings.soft_limits = None,
            Command::OverdriveMode { .. } if !self.config.overdrive => return Status::E_FEATURE_NOT_SUPPORTED,
            Command::OverdriveMode { on } => self.settings.set_overdrive(on, &self.config),
            // Ruling: an empty tag removes the tag.
            Command::SetDeviceTag(tag) if self.config.generation == Generation::Fw4 && !tag.is_ascii() => {
                return Status::E_INVALID_PARAMETER;
            }
            Command::SetDeviceTag(tag) => {
                self.settings.device_tag = Some(tag.stripped()).filter(|tag| !tag.is_empty());
            }
            _ => {}
        }
        self.mechanics.set_force_limit(self.settings.force_limit_n, !self.config.is_fw4());
        Status::E_SUCCESS
    }

    /// Tares the force sensor (`fw4-en 3.3.9`).
    fn tare(&mut self) -> Status {
        if !self.config.has_force_sensor() {
            return Status::E_NOT_AVAILABLE;
        }
        if self.mechanics.is_holding() {
            return Status::E_ACCESS_DENIED;
        }
        self.sensor_offset_n = -self.mechanics.axis.force_n;
        Status::E_SUCCESS
    }

    /// Answers a getter (`fw4-en 3.4.1`). A query without updates switches updates off.
    fn query(&mut self, id: u8, updates: Updates) {
        let value = self.value(id);
        self.subscriptions.set(id, updates, Some(value.clone()), self.clock);
        if updates == Updates::Off || self.config.answers_update_requests {
            self.answer(id, Reply::Success(value));
        }
    }

    fn get(&mut self, command: &Command) -> Result<Data, Status> {
        Ok(match command {
            Command::GetAcceleration => {
                let value = self.settings.acceleration_mm_s2 as f32;
                Data::Acceleration(Acceleration::new(value).unwrap_or(Acceleration::ZERO))
            }
            Command::GetForceLimit => {
                let value = self.settings.force_limit_n as f32;
                Data::ForceLimit(Force::new(value).unwrap_or(Force::ZERO))
            }
            Command::GetSoftLimits => Data::SoftLimits(self.settings.soft_limits.ok_or(Status::E_NOT_AVAILABLE)?),
            Command::GetStatistics { reset } => {
                let statistics = self.process.statistics;
                if *reset {
                    self.process.statistics = wsg::Statistics::default();
                }
                Data::Statistics(statistics)
            }
            Command::GetTemperature => {
                let tenths = (self.thermal.temperature_c(self.clock) * 10.0).round();
                Data::Temperature(Temperature(tenths as i16))
            }
            Command::GetSystemInfo => Data::SystemInfo(self.system_info()),
            Command::GetDeviceTag => Data::DeviceTag(self.settings.device_tag.clone().ok_or(Status::E_NOT_AVAILABLE)?),
            Command::GetSystemLimits => Data::SystemLimits(self.config.limits),
            Command::GetFingerInfo(finger) => Data::FingerInfo(*finger, self.fingers[index(*finger)].info()),
            Command::GetFingerFlags(finger) => Data::FingerFlags(*finger, self.fingers[index(*finger)].flags()),
            Command::GetFingerData(finger) => {
                let data = self.fingers[index(*finger)].data(self.shown_force_n())?;
                Data::FingerData(*finger, data)
            }
            _ => return Err(Status::E_CMD_UNKNOWN),
        })
    }

    /// Switches a finger's power: on takes time, off is immediate (`fw4-en 3.6.3`).
    fn finger_power(&mut self, id: u8, finger: Finger, on: bool) {
        let index = index(finger);
        let port = &mut self.fingers[index];
        let status = port.set_power(on, self.clock);
        if status == Status::E_CMD_PENDING {
            let ticket = self.pending(id);
            self.finger_tickets[index] = Some(ticket);
            return;
        }
        if !on && status == Status::E_SUCCESS {
            port.powered_up_at = None;
            if let Some(ticket) = self.finger_tickets[index].take() {
                self.result_status(ticket, Status::E_CMD_ABORTED);
            }
        }
        self.answer_status(id, status);
    }

    fn run_script(&mut self, command: &CustomCommand) {
        let id = command.id();
        let Some(script) = self.config.scripts.iter().find(|script| script.id == id) else { return };
        let bytes = match &script.answer {
            ScriptAnswer::Echo => command.payload().to_vec(),
            ScriptAnswer::Bytes(bytes) => bytes.clone(),
            ScriptAnswer::Measurement => self.measurement(),
            ScriptAnswer::Status(code) => {
                let status = Status::from_code(*code);
                return self.answer_status(id, status);
            }
        };
        self.answer(id, Reply::Success(Data::Custom(bytes)));
    }

    fn measurement(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for id in [id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE] {
            self.value(id).write(&mut bytes);
        }
        bytes
    }
}

fn index(finger: Finger) -> usize {
    match finger {
        Finger::One => 0,
        Finger::Two => 1,
    }
}

#[cfg(test)]
#[path = "commands_tests.rs"]
mod tests;

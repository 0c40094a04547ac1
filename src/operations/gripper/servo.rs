//! Servo sessions: start, target, follow, stop.

use std::time::Duration;

use jiff::Timestamp;
use serde::Deserialize;
use utoipa::ToSchema;

use crate::model::{ServoAdapter, ServoAim, ServoReport, ServoTarget, ServoTerms, Steer, Urgency};
use crate::operations::calls::call::{Call, Gripper, Leased, NoFields};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::{Json, SharedJson};
use crate::operations::parameters::values::{LeaseField, Whole, force, speed, width};
use crate::operations::problem::Problem;
use crate::wsg::{Speed, Width};

operations! {
    /// Get the servo session
    ///
    /// Returns the session that is open, or the last one since the gateway started.
    GET = GET "/grippers/{gripper}/servo" as "servo" {
        run: get, id: "get_servo", tag: "servo", problems: GRIPPER,
        answer: "The session",
    };

    /// Begin a servo session
    ///
    /// The client then steers the fingers by targets, many times a second. Silence for `timeout_ms`, a Stop, a FAST STOP, and
    /// the loss of the lease or of the link end the session and stop the fingers. Other motions are refused meanwhile.
    START = POST "/grippers/{gripper}/servo/start" as "servo.start" {
        run: start, id: "start_servo", tag: "servo", problems: DEVICE,
        answer: "The session",
    };

    /// Set the target width
    ///
    /// The newest target replaces an older one that the device has not got yet. Use a WebSocket or Zenoh for many targets
    /// a second; a notification or a put gets no answer.
    TARGET = POST "/grippers/{gripper}/servo/target" as "servo.target" {
        run: target, id: "set_servo_target", tag: "servo", problems: DEVICE,
        answer: "The session",
    }.with_some_field();

    /// Follow a series of widths
    ///
    /// The gateway interpolates between the widths. A newer series or target replaces the rest. The last width stays the
    /// target, and silence counts from its time.
    FOLLOW = POST "/grippers/{gripper}/servo/follow" as "servo.follow" {
        run: follow, id: "follow_servo_widths", tag: "servo", problems: DEVICE,
        answer: "The session",
    }.with_some_field();

    /// End the servo session
    ///
    /// Stops the fingers if they move.
    STOP = POST "/grippers/{gripper}/servo/stop" as "servo.stop" {
        run: stop, id: "stop_servo", tag: "servo", problems: DEVICE,
        answer: "The session, which has ended",
    }.urgent(Urgency::Stop);
}

const DEFAULT_TIMEOUT_MS: u64 = 200;
const DEFAULT_MAX_SPEED_MM_S: f64 = 100.0;

/// Most widths in a series, and the longest time of a series.
const MAX_WIDTHS: usize = 256;
const MAX_SERIES: Duration = Duration::from_secs(10);

/// Silence that ends a session, in ms.
type Timeout = Whole<20, 10_000>;

/// Time between two widths, in ms.
type Step = Whole<1, 1000>;

/// Terms of a servo session.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"timeout_ms": 200, "max_speed_mm_s": 150.0}))]
pub struct StartServo {
    /// Way in which targets reach the fingers; by default `servo_adapter` of the configuration.
    adapter: Option<ServoAdapter>,
    /// Silence after which the session ends with a Stop, in ms; 200 by default.
    timeout_ms: Option<Timeout>,
    /// Greatest speed of a target, and the speed of targets without one, in mm/s; 100 by default.
    #[schema(minimum = 0, maximum = 10000)]
    max_speed_mm_s: Option<f64>,
    /// Force limit in N, which is set before the first target. Required by adapters whose script gets a force.
    #[schema(minimum = 0, maximum = 10000)]
    force_n: Option<f64>,
    lease: Option<LeaseField>,
}

/// A target width.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"width_mm": 42.5}))]
pub struct AimServo {
    /// Target width in mm.
    #[schema(minimum = 0, maximum = 1000)]
    width_mm: f64,
    /// Speed in mm/s; by default `max_speed_mm_s` of the session.
    #[schema(minimum = 0, maximum = 10000)]
    speed_mm_s: Option<f64>,
    /// Time that the target belongs to, by the gateway's clock (see `clock`). A target is refused as `stale_target` if its
    /// time is not later than that of the newest one, or is older than `timeout_ms`.
    at: Option<Timestamp>,
    lease: Option<LeaseField>,
}

/// A series of target widths.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"widths_mm": [40.0, 42.0, 45.0], "dt_ms": 50}))]
pub struct Follow {
    /// Target widths in mm: 1 to 256. The first one is for `at`.
    #[schema(min_items = 1, max_items = 256)]
    widths_mm: Vec<f64>,
    /// Time between two widths in ms. A series takes at most 10 s.
    dt_ms: Step,
    /// Time of the first width, by the gateway's clock; now by default. At most 1 s ahead.
    at: Option<Timestamp>,
    lease: Option<LeaseField>,
}

fn get(call: &Call<NoFields>) -> Result<SharedJson<ServoReport>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    let report = gripper.handle.state().servo.clone();
    report.map(SharedJson).ok_or_else(|| Problem::not_found("servo session of this gripper yet"))
}

async fn start(call: Call<StartServo>) -> Result<Json<ServoReport>, Problem> {
    let (gripper, fields) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(fields.lease.as_deref())?;
    let timeout_ms = fields.timeout_ms.map_or(Ok(DEFAULT_TIMEOUT_MS), |given| given.checked("timeout_ms"))?;
    let terms = ServoTerms {
        adapter: fields.adapter,
        timeout: Duration::from_millis(timeout_ms),
        max_speed: speed("max_speed_mm_s", fields.max_speed_mm_s.unwrap_or(DEFAULT_MAX_SPEED_MM_S))?,
        force: fields.force_n.map(|n| force("force_n", n)).transpose()?,
    };
    steer(gripper, Steer::Start(terms)).await
}

async fn target(call: Call<AimServo>) -> Result<Json<ServoReport>, Problem> {
    let (gripper, fields) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(fields.lease.as_deref())?;
    let speed: Option<Speed> = fields.speed_mm_s.map(|mm_s| speed("speed_mm_s", mm_s)).transpose()?;
    let aim = ServoAim::Width(width("width_mm", fields.width_mm)?);
    steer(gripper, Steer::Aim(ServoTarget { aim, speed, at: fields.at })).await
}

async fn follow(call: Call<Follow>) -> Result<Json<ServoReport>, Problem> {
    let (gripper, fields) = call.gripper_and_fields()?;
    let gripper = gripper.with_lease(fields.lease.as_deref())?;
    let step = Duration::from_millis(fields.dt_ms.checked("dt_ms")?);
    let count = fields.widths_mm.len();
    if count == 0 || count > MAX_WIDTHS {
        return Err(Problem::malformed("widths_mm", format!("widths_mm must have 1 to {MAX_WIDTHS} widths")));
    }
    let longest_step = MAX_SERIES / (count.max(2) as u32 - 1);
    if step > longest_step {
        let step_ms = step.as_millis() as f64;
        return Err(Problem::out_of_range("dt_ms", step_ms, 1.0, longest_step.as_millis() as f64));
    }
    let widths: Result<Vec<Width>, Problem> = fields.widths_mm.iter().map(|mm| width("widths_mm", *mm)).collect();
    let aim = ServoAim::Widths(widths?.into(), step);
    steer(gripper, Steer::Aim(ServoTarget { aim, speed: None, at: fields.at })).await
}

async fn stop(call: Call<Leased>) -> Result<Json<ServoReport>, Problem> {
    steer(call.leased()?, Steer::Stop).await
}

async fn steer(gripper: Gripper, request: Steer) -> Result<Json<ServoReport>, Problem> {
    let token = gripper.token();
    Ok(Json(gripper.handle.steer(request, gripper.client.clone(), token).await?))
}

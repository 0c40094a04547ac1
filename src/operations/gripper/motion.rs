//! Home, move, grip, release, stop.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use utoipa::ToSchema;

use super::commands;
use crate::access::Right;
use crate::model::{Action, CommandReport, Direction, Motion, OnBlock, RecipeValues, Urgency};
use crate::operations::calls::call::Call;
use crate::operations::calls::caller::{DEFAULT_WAIT_MS, RequestKeys};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::OrRunning;
use crate::operations::parameters::values::{
    LeaseField, PartIdText, RecipeOrNone, RequestIdText, Version, force, speed, width,
};
use crate::operations::problem::Problem;
use crate::operations::recipes::requested_recipe::RequestedRecipe;
use crate::wsg::MoveFlags;

operations! {
    /// Home the fingers
    ///
    /// References the gripper at an end stop. Required once after the device was switched on, before any other motion.
    /// Keep the path of the fingers clear: an obstacle gives a wrong origin.
    HOME = POST "/grippers/{gripper}/home" as "home" {
        run: submit::<Home>, id: "home", tag: "motion", problems: DEVICE,
        answer: "The ended command, with its `outcome`",
    }.command();

    /// Move the fingers
    ///
    /// The gateway refuses a width or speed beyond the device's limits, which the device itself would clamp. It also
    /// refuses a target outside the soft limits.
    MOVE = POST "/grippers/{gripper}/move" as "move" {
        run: submit::<Move>, id: "move_to", tag: "motion", problems: DEVICE,
        answer: "The ended command, with its `outcome`",
    }.command();

    /// Grip a part
    ///
    /// Ends with `PART_HELD`, or with `NO_PART` if the fingers found no part. `NO_PART` is a result, not an error.
    GRIP = POST "/grippers/{gripper}/grip" as "grip" {
        run: submit::<Grip>, id: "grip", tag: "motion", problems: RECIPE_MOTION,
        answer: "The ended command, with its `outcome`",
    }.command().with_some_field();

    /// Release a part
    ///
    /// Opens the fingers to `width_mm`.
    RELEASE = POST "/grippers/{gripper}/release" as "release" {
        run: submit::<Release>, id: "release", tag: "motion", problems: RECIPE_MOTION,
        answer: "The ended command, with its `outcome`",
    }.command().with_some_field();

    /// Stop
    ///
    /// Ends a running motion, whose command ends with `ABORTED`. Needs no lease and latches nothing. A stop that the
    /// same client repeats within a second, while nothing runs, returns the same command with `replayed`. A malformed
    /// body stops as well.
    STOP = POST "/grippers/{gripper}/stop" as "stop" {
        run: submit::<Stop>, id: "stop", tag: "motion", problems: DEVICE,
        answer: "The ended command, with its `outcome`",
    }.command().needs(Right::Stop).urgent(Urgency::Stop).despite_mistakes();
}

/// Parameters of a motion or of a stop.
trait ActionFields: Sized {
    /// Parses the parameters. `call` has the gripper's name and the recipes.
    fn action(self, call: &Call<Self>) -> Result<Action, Problem>;

    /// The action for malformed parameters, unless they are refused.
    const FALLBACK: Option<Action> = None;
}

/// Parameters that every motion shares.
trait KeyFields {
    /// Returns the request id and the lease token.
    fn keys(&self) -> (Option<String>, Option<&str>);
}

/// Declares a command's body: its own fields, and those that all commands share.
macro_rules! command_body {
    ($(#[$meta:meta])* $name:ident { $($fields:tt)* }) => {
        #[derive(Debug, Deserialize, ToSchema)]
        #[serde(deny_unknown_fields)]
        $(#[$meta])*
        pub struct $name {
            $($fields)*
            /// Id that makes the request safe to repeat: for 10 minutes, the same id returns the same command. Only a Stop
            /// is sent again while the fingers move. At most 64 bytes, or a whole number, which is treated as text;
            /// empty means none.
            request_id: Option<RequestIdText>,
            lease: Option<LeaseField>,
        }

        impl KeyFields for $name {
            fn keys(&self) -> (Option<String>, Option<&str>) {
                (self.request_id.as_ref().map(ToString::to_string), self.lease.as_deref())
            }
        }
    };
}

command_body! {
    /// Parameters of a homing run.
    #[schema(example = json!({"direction": "default"}))]
    Home {
        /// End stop to home to.
        #[serde(default)]
        #[schema(default = "default")]
        direction: Direction,
    }
}

command_body! {
    /// Parameters of a move.
    #[schema(example = json!({"width_mm": 40.0, "speed_mm_s": 100.0}))]
    Move {
        /// Opening width to move to, or its change if `relative` is set, in mm.
        #[schema(minimum = -1000, maximum = 1000)]
        width_mm: f64,
        /// Speed of the fingers relative to each other, in mm/s.
        #[schema(minimum = 0, maximum = 10000)]
        speed_mm_s: f64,
        /// Whether `width_mm` is a change of the current width.
        #[serde(default)]
        #[schema(default = false)]
        relative: bool,
        /// Reaction of the fingers to an obstacle.
        #[serde(default)]
        #[schema(default = "stop")]
        on_block: OnBlock,
    }
}

command_body! {
    /// Parameters of a grip.
    #[schema(example = json!({"width_mm": 20.0, "speed_mm_s": 50.0, "force_n": 40.0, "part_id": "A-1047"}))]
    Grip {
        /// Nominal width of the part, in mm; by default that of the recipe.
        #[schema(minimum = 0, maximum = 1000)]
        width_mm: Option<f64>,
        /// Speed of the fingers relative to each other, in mm/s; by default that of the recipe.
        #[schema(minimum = 0, maximum = 10000)]
        speed_mm_s: Option<f64>,
        /// Force limit in N; by default that of the recipe. It is set before the grip and stays set; without it, the
        /// current limit applies.
        #[schema(minimum = 0, maximum = 10000)]
        force_n: Option<f64>,
        /// Id of the part, for the records and to find its recipe: at most 48 bytes, or a whole number, which is stored as
        /// text. By default that of the recipe.
        part_id: Option<PartIdText>,
        /// Number of the recipe. Without it, the recipe of the part is used if `width_mm` or `speed_mm_s` is missing. 0: no
        /// recipe.
        recipe: Option<RecipeOrNone>,
        /// Version that the recipe must have; otherwise the request fails with 412.
        recipe_version: Option<Version>,
        /// Whether this is a reference grip, that is, a grip on a gauge. Its kind is `reference`, and the request needs a
        /// `part_id` or a `recipe`.
        #[serde(default)]
        #[schema(default = false)]
        reference: bool,
    }
}

command_body! {
    /// Parameters of a release.
    #[schema(example = json!({"width_mm": 60.0, "speed_mm_s": 100.0}))]
    Release {
        /// Opening width to open to, in mm; by default that of the recipe.
        #[schema(minimum = 0, maximum = 1000)]
        width_mm: Option<f64>,
        /// Speed of the fingers relative to each other, in mm/s; by default that of the recipe.
        #[schema(minimum = 0, maximum = 10000)]
        speed_mm_s: Option<f64>,
        /// Id of the part, to find its recipe: at most 48 bytes, or a whole number, which is treated as text.
        part_id: Option<PartIdText>,
        /// Number of the recipe. Without it, the recipe of the part is used if `width_mm` or `speed_mm_s` is missing. 0: no
        /// recipe.
        recipe: Option<RecipeOrNone>,
        /// Version that the recipe must have; otherwise the request fails with 412.
        recipe_version: Option<Version>,
    }
}

command_body! {
    /// Parameters of a stop.
    #[schema(example = json!({}))]
    Stop {}
}

impl ActionFields for Home {
    fn action(self, _: &Call<Self>) -> Result<Action, Problem> {
        Ok(Action::Motion(Motion::Home(self.direction.into())))
    }
}

impl ActionFields for Move {
    fn action(self, _: &Call<Self>) -> Result<Action, Problem> {
        Ok(Action::Motion(Motion::Move {
            flags: MoveFlags { relative: self.relative, stop_on_block: self.on_block == OnBlock::Stop },
            width: width("width_mm", self.width_mm)?,
            speed: speed("speed_mm_s", self.speed_mm_s)?,
        }))
    }
}

impl ActionFields for Grip {
    fn action(self, call: &Call<Self>) -> Result<Action, Problem> {
        let is_complete = self.width_mm.is_some() && self.speed_mm_s.is_some();
        let recipe = RequestedRecipe::of(call, self.recipe, self.recipe_version, self.part_id, is_complete)?;
        let RecipeValues { width_mm, speed_mm_s, force_n, .. } = recipe.values();
        let part_id = recipe.part_id();
        if self.reference && part_id.is_none() {
            return Err(Problem::malformed(
                "part_id",
                "part_id is missing: send the gauge's part_id, or the recipe of the gauge",
            ));
        }
        Ok(Action::Motion(Motion::Grip {
            width: width("width_mm", recipe.required("width_mm", self.width_mm.or(width_mm))?)?,
            speed: speed("speed_mm_s", recipe.required("speed_mm_s", self.speed_mm_s.or(speed_mm_s))?)?,
            force: self.force_n.or(force_n).map(|n| force("force_n", n)).transpose()?,
            recipe: recipe.applied(),
            part_id,
            is_reference: self.reference,
        }))
    }
}

impl ActionFields for Release {
    fn action(self, call: &Call<Self>) -> Result<Action, Problem> {
        let is_complete = self.width_mm.is_some() && self.speed_mm_s.is_some();
        let recipe = RequestedRecipe::of(call, self.recipe, self.recipe_version, self.part_id, is_complete)?;
        let RecipeValues { release_width_mm, release_speed_mm_s, speed_mm_s, .. } = recipe.values();
        let by_recipe = release_speed_mm_s.or(speed_mm_s);
        Ok(Action::Motion(Motion::Release {
            width: width("width_mm", recipe.required("width_mm", self.width_mm.or(release_width_mm))?)?,
            speed: speed("speed_mm_s", recipe.required("speed_mm_s", self.speed_mm_s.or(by_recipe))?)?,
        }))
    }
}

impl ActionFields for Stop {
    fn action(self, _: &Call<Self>) -> Result<Action, Problem> {
        Ok(Action::Stop)
    }

    /// A mistake in a request must not keep the fingers moving.
    const FALLBACK: Option<Action> = Some(Action::Stop);
}

async fn submit<P: ActionFields + KeyFields + DeserializeOwned>(
    mut call: Call<P>,
) -> Result<OrRunning<CommandReport>, Problem> {
    if P::FALLBACK.is_some() {
        call.caller = call.caller.without_mistakes();
    }
    let gripper = call.gripper()?;
    let wait = call.wait(DEFAULT_WAIT_MS)?;
    let (keys, action) = match parse(&call) {
        Ok(parsed) => parsed,
        Err(problem) => (RequestKeys::default(), P::FALLBACK.ok_or(problem)?),
    };
    let (command, ticket) = commands::submit(gripper, keys, action, &wait).await?;
    commands::reply_with(&command, ticket)
}

fn parse<P: ActionFields + KeyFields + DeserializeOwned>(call: &Call<P>) -> Result<(RequestKeys, Action), Problem> {
    let keys = call.keys()?;
    let fields = call.fields()?;
    let (request_id, lease) = fields.keys();
    Ok((keys.or_fields(request_id.as_deref(), lease)?, fields.action(call)?))
}

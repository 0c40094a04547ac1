//! The parameters of a motion, as requests and records name them.

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::{Action, Motion, PartId, RecipeFields};
use wsg::{Force, HomingDirection};

/// Parameters of a command, named as in the request. Those that do not apply are absent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default, ToSchema)]
pub struct Parameters {
    /// Direction of homing.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub direction: Option<Direction>,
    /// Target width in mm, or the offset if `relative` is true.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub width_mm: Option<f32>,
    /// Speed in mm/s.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub speed_mm_s: Option<f32>,
    /// Whether the width is an offset from the current width.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub relative: Option<bool>,
    /// Reaction to an obstacle.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub on_block: Option<OnBlock>,
    /// Force limit to set before the grip, in N.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub force_n: Option<f32>,
    /// Name of the part.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub part_id: Option<PartId>,
    #[serde(flatten)]
    pub recipe: RecipeFields,
    /// Id of a custom command.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub raw_id: Option<u8>,
    /// Payload of a custom command, as hex.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false, max_length = 8192)]
    pub payload: Option<String>,
}

/// End stop that homing moves to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// As configured on the device.
    #[default]
    Default,
    /// The outer end stop.
    Outer,
    /// The inner end stop.
    Inner,
}

impl From<Direction> for HomingDirection {
    fn from(direction: Direction) -> Self {
        match direction {
            Direction::Default => Self::Default,
            Direction::Outer => Self::Outer,
            Direction::Inner => Self::Inner,
        }
    }
}

impl From<HomingDirection> for Direction {
    fn from(direction: HomingDirection) -> Self {
        match direction {
            HomingDirection::Default => Self::Default,
            HomingDirection::Outer => Self::Outer,
            HomingDirection::Inner => Self::Inner,
        }
    }
}

/// Reaction when the fingers meet an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum OnBlock {
    /// The motor is switched off.
    #[default]
    Stop,
    /// The fingers keep pushing, and snap to the target when they are freed.
    Clamp,
}

impl From<&Action> for Parameters {
    fn from(action: &Action) -> Self {
        let Action::Motion(motion) = action else { return Self::default() };
        match motion {
            Motion::Home(direction) => Self { direction: Some((*direction).into()), ..Self::default() },
            Motion::Move { flags, width, speed } => Self {
                width_mm: Some(width.mm()),
                speed_mm_s: Some(speed.mm_s()),
                relative: Some(flags.relative),
                on_block: Some(if flags.stop_on_block { OnBlock::Stop } else { OnBlock::Clamp }),
                ..Self::default()
            },
            Motion::Grip { width, speed, force, part_id, recipe, .. } => Self {
                width_mm: Some(width.mm()),
                speed_mm_s: Some(speed.mm_s()),
                force_n: force.map(Force::n),
                part_id: part_id.clone(),
                recipe: recipe.as_ref().map(RecipeFields::from).unwrap_or_default(),
                ..Self::default()
            },
            Motion::Release { width, speed } => {
                Self { width_mm: Some(width.mm()), speed_mm_s: Some(speed.mm_s()), ..Self::default() }
            }
            Motion::Custom(custom) => {
                let payload = Some(hex::encode(custom.payload()));
                Self { raw_id: Some(custom.id()), payload, ..Self::default() }
            }
        }
    }
}

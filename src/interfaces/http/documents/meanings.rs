//! The meanings of the values that enumerations have, from the doc comments of their variants.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::{Value, json};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use crate::access::{FastStopPolicy, Proof, Role};
use crate::events::Topic;
use crate::journal::{EventKind, Order};
use crate::model::{
    AlarmKind, AlarmStep, Code, Direction, Door, FastStopCause, FastStopStep, FrameDirection, Kind, LeaseStep, Link,
    LossCause, LossEffect, OnBlock, OnLossHolding, OnLossMoving, Outcome, Phase, RecipeStep, WireDamage,
};
use crate::operations::records::GripKinds;
use crate::operations::statistics::MeasuredGrips;

/// The values of an enumeration, each with its meaning.
pub type Meanings = Vec<(Value, String)>;

/// Returns the meanings of all enumerations by the names of their schemas.
pub fn all() -> BTreeMap<String, Meanings> {
    [
        of::<AlarmKind>(),
        of::<AlarmStep>(),
        of::<Code>(),
        of::<Direction>(),
        of::<Door>(),
        of::<EventKind>(),
        of::<FastStopCause>(),
        of::<FastStopPolicy>(),
        of::<FastStopStep>(),
        of::<FrameDirection>(),
        of::<GripKinds>(),
        of::<Kind>(),
        of::<LeaseStep>(),
        of::<Link>(),
        of::<LossCause>(),
        of::<LossEffect>(),
        of::<MeasuredGrips>(),
        of::<OnBlock>(),
        of::<OnLossHolding>(),
        of::<OnLossMoving>(),
        of::<Order>(),
        of::<Outcome>(),
        of::<Phase>(),
        of::<Proof>(),
        of::<RecipeStep>(),
        of::<Role>(),
        of::<Topic>(),
        of::<WireDamage>(),
    ]
    .into()
}

fn of<T: EnumMessage + VariantArray + Serialize + ToSchema>() -> (String, Meanings) {
    (T::name().into_owned(), T::VARIANTS.iter().map(meaning).collect())
}

/// Returns a value and its doc comment, whose lines are joined.
fn meaning<T: EnumMessage + Serialize>(value: &T) -> (Value, String) {
    let words = value.get_documentation().unwrap_or_default().split_whitespace();
    (json!(value), words.collect::<Vec<_>>().join(" "))
}

/// Adds the meanings of the values to the schema of an enumeration: to its description, and as the extensions that code
/// generators read.
pub fn describe(schema: &mut Value, meanings: &Meanings) {
    let list: Vec<_> = meanings.iter().map(|(value, meaning)| format!("- `{}`: {meaning}", word(value))).collect();
    let intro = schema["description"].as_str().unwrap_or_default();
    schema["description"] = format!("{intro}\n\n{}", list.join("\n")).into();
    schema["x-enumDescriptions"] = meanings.iter().map(|(value, meaning)| (word(value), json!(meaning))).collect();
    schema["x-enum-descriptions"] = meanings.iter().map(|(_, meaning)| json!(meaning)).collect();
}

fn word(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

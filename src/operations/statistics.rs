//! Statistics of grips: how often they hold a part, how the figures spread, and how well they fit the recipe's limits.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::calls::call::Call;
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::parameters::values::{TextOrNumber, gripper_or_gateway, integer, part_id};
use super::problem::Problem;
use crate::journal::{Distribution, GripStatistics, StatisticsQuery};
use crate::model::time::milliseconds_or_null;
use crate::model::{Kind, Outcome, PartId};

operations! {
    /// Get statistics of grips
    ///
    /// Returns how the grips ended, the spread of their contact widths, forces and times, and with a `part_id` how well
    /// the contact widths fit the limits of the part's recipe. All grips in the journal count, or those that the
    /// parameters select.
    STATISTICS = GET "/grips/statistics" as "grips.statistics" {
        run: statistics, id: "grip_statistics", tag: "journal", problems: JOURNAL,
        answer: "The statistics",
    };
}

/// Greatest number of grips that a request can name.
const MAX_WINDOW: u64 = 1_000_000;

/// Filter of the grips that count.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StatisticsFields {
    /// Only grips of this part. At most 48 bytes.
    #[schema(value_type = Option<String>, min_length = 1, max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]+$", example = "A-1047")]
    part_id: Option<TextOrNumber>,
    /// Only grips of this gripper.
    #[schema(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// Only grips from this time on.
    #[schema(format = DateTime, example = "2026-11-21T09:00:00Z")]
    from: Option<String>,
    /// Only grips before this time.
    #[schema(format = DateTime, example = "2026-11-22T09:00:00Z")]
    to: Option<String>,
    /// Kind of the grips: `grip` (default), or `reference` for reference grips.
    #[serde(default)]
    kind: MeasuredGrips,
    /// Number of the part's newest grips; all by default. Needs `part_id`.
    #[schema(value_type = Option<u32>, minimum = 1, maximum = 1_000_000)]
    window: Option<TextOrNumber>,
}

/// Kind of measured grips.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum MeasuredGrips {
    /// Grips of parts.
    #[default]
    Grip,
    /// Reference grips, on gauges.
    Reference,
}

/// Statistics of grips.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "count": 3, "outcomes": [{"outcome": "NO_PART", "count": 1, "rate": 0.333}, {"outcome": "PART_HELD", "count": 2, "rate": 0.667}],
    "first_at": "2026-11-21T09:00:00.000Z", "last_at": "2026-11-21T09:05:00.000Z",
    "contact_width_mm": {"count": 2, "mean": 20.0, "standard_deviation": 0.05, "min": 19.96, "max": 20.04},
    "force_n": {"count": 2, "mean": 40.0, "standard_deviation": 0.0, "min": 40.0, "max": 40.0},
    "time_to_contact_ms": {"count": 2, "mean": 300.0, "standard_deviation": 2.0, "min": 298.0, "max": 302.0},
    "moving_average_mm": 20.01, "accept_min_mm": 19.5, "accept_max_mm": 20.5, "recipe_version": 3, "cpk": 3.3
}))]
pub struct StatisticsOfGrips {
    /// Number of grips.
    count: u64,
    /// Grips by outcome; outcomes without grips are left out.
    outcomes: Vec<OutcomeShare>,
    /// Time of the oldest grip; null without grips.
    #[serde(serialize_with = "milliseconds_or_null")]
    #[schema(required)]
    first_at: Option<Timestamp>,
    /// Time of the newest grip; null without grips.
    #[serde(serialize_with = "milliseconds_or_null")]
    #[schema(required)]
    last_at: Option<Timestamp>,
    /// Contact widths of the grips with a part (`PART_HELD` and `WRONG_PART`), in mm.
    contact_width_mm: Spread,
    /// Gripping forces at the ends of these grips, in N.
    force_n: Spread,
    /// Times to contact of these grips, in ms.
    time_to_contact_ms: Spread,
    /// Exponentially weighted moving average of the contact widths, in mm; each new value weighs 0.2. Null without a
    /// `part_id`.
    #[schema(required)]
    moving_average_mm: Option<f64>,
    /// Smallest accepted contact width in the part's recipe, in mm; null without a recipe or limit.
    #[schema(required)]
    accept_min_mm: Option<f64>,
    /// Largest accepted contact width in the part's recipe, in mm; null without a recipe or limit.
    #[schema(required)]
    accept_max_mm: Option<f64>,
    /// Version of that recipe; null if the part has no recipe.
    #[schema(required)]
    recipe_version: Option<u64>,
    /// Process capability Cpk: distance of the mean from the nearer limit, in units of three standard deviations. Null
    /// without a limit or a spread.
    #[schema(required)]
    cpk: Option<f64>,
}

/// Number and share of the grips with an outcome.
#[derive(Debug, Serialize, ToSchema)]
pub struct OutcomeShare {
    #[schema(value_type = Outcome)]
    outcome: &'static str,
    /// Number of grips.
    #[schema(minimum = 0)]
    count: u64,
    /// Share of all grips, from 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    rate: f64,
}

/// Spread of a figure.
#[derive(Debug, Serialize, ToSchema)]
pub struct Spread {
    /// Number of grips that have the figure.
    #[schema(minimum = 0)]
    count: u64,
    /// Mean; null without grips.
    #[schema(required)]
    mean: Option<f64>,
    /// Standard deviation of a sample; null with fewer than two grips.
    #[schema(required)]
    standard_deviation: Option<f64>,
    /// Smallest value; null without grips.
    #[schema(required)]
    min: Option<f64>,
    /// Greatest value; null without grips.
    #[schema(required)]
    max: Option<f64>,
}

impl From<Distribution> for Spread {
    fn from(distribution: Distribution) -> Self {
        let (min, max) = distribution.range().unzip();
        Self {
            count: distribution.count,
            mean: distribution.mean(),
            standard_deviation: distribution.standard_deviation(),
            min,
            max,
        }
    }
}

async fn statistics(call: Call<StatisticsFields>) -> Result<Json<StatisticsOfGrips>, Problem> {
    let query = query(call.fields()?)?;
    let statistics = call.gateway.journal.statistics(query.clone()).await?;
    Ok(Json(report(&call, &query, &statistics)))
}

fn query(fields: StatisticsFields) -> Result<StatisticsQuery, Problem> {
    let part_id: Option<PartId> = fields.part_id.map(|given| part_id("part_id", &given.to_string())).transpose()?;
    let gripper = fields.gripper.map(|given| gripper_or_gateway("gripper", &given));
    let window = fields.window.as_ref().map(window).transpose()?;
    if window.is_some() && part_id.is_none() {
        return Err(Problem::malformed("window", "window needs a part_id: only the grips of one part are in order"));
    }
    Ok(StatisticsQuery {
        part_id,
        gripper: gripper.transpose()?,
        kind: match fields.kind {
            MeasuredGrips::Grip => Kind::Grip,
            MeasuredGrips::Reference => Kind::Reference,
        },
        from: time("from", fields.from.as_deref())?,
        to: time("to", fields.to.as_deref())?,
        window: window.and_then(|window| u32::try_from(window).ok()),
    })
}

fn window(given: &TextOrNumber) -> Result<u64, Problem> {
    let number = given.to_string().parse::<f64>();
    let number = number.map_err(|_| Problem::malformed("window", "window must be a number of grips"))?;
    integer("window", number, 1..=MAX_WINDOW)
}

fn time(field: &str, given: Option<&str>) -> Result<Option<Timestamp>, Problem> {
    let Some(text) = given else { return Ok(None) };
    text.parse::<Timestamp>().map(Some).map_err(|_| {
        Problem::malformed(field, format!("{field} must be a time like 2026-11-21T09:00:00Z (RFC 3339)"))
            .value(Some(text.into()))
    })
}

fn report<P>(call: &Call<P>, query: &StatisticsQuery, statistics: &GripStatistics) -> StatisticsOfGrips {
    let count = statistics.count();
    let outcomes = statistics.outcomes.iter().map(|(outcome, number)| OutcomeShare {
        outcome,
        count: *number,
        rate: *number as f64 / count as f64,
    });
    let recipe = query.part_id.as_ref().and_then(|part_id| call.gateway.recipes.of_part(part_id));
    let values = recipe.as_ref().map(|version| match &query.gripper {
        Some(gripper) => version.recipe.values_for(gripper),
        None => version.recipe.values,
    });
    let values = values.unwrap_or_default();
    StatisticsOfGrips {
        count,
        outcomes: outcomes.collect(),
        first_at: statistics.times.and_then(|(oldest, _)| Timestamp::from_millisecond(oldest).ok()),
        last_at: statistics.times.and_then(|(_, newest)| Timestamp::from_millisecond(newest).ok()),
        cpk: cpk(&statistics.contact_width_mm, values.accept_min_mm, values.accept_max_mm),
        contact_width_mm: statistics.contact_width_mm.into(),
        force_n: statistics.force_n.into(),
        time_to_contact_ms: statistics.time_to_contact_ms.into(),
        moving_average_mm: statistics.moving_average_mm,
        accept_min_mm: values.accept_min_mm,
        accept_max_mm: values.accept_max_mm,
        recipe_version: recipe.map(|version| version.version),
    }
}

fn cpk(widths: &Distribution, min: Option<f64>, max: Option<f64>) -> Option<f64> {
    let mean = widths.mean()?;
    let deviation = widths.standard_deviation().filter(|deviation| *deviation > 0.0)?;
    let distances = [min.map(|min| mean - min), max.map(|max| max - mean)];
    distances.into_iter().flatten().reduce(f64::min).map(|distance| distance / (3.0 * deviation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cpk_counts_the_nearer_limit() {
        let widths: Distribution = [19.0, 20.0, 21.0].into_iter().collect();
        assert_eq!(cpk(&widths, Some(17.0), Some(21.5)), Some(0.5));
        assert_eq!(cpk(&widths, Some(17.0), None), Some(1.0));
        assert_eq!(cpk(&widths, None, None), None);
        let without_spread: Distribution = [20.0, 20.0].into_iter().collect();
        assert_eq!(cpk(&without_spread, Some(17.0), None), None);
    }
}

//! Proposed limits of a recipe: the contact widths of the part's last grips.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::access::Right;
use crate::gripper::limits::WIDEST_MM;
use crate::journal::{Distribution, Filter, GripQuery, Limit};
use crate::model::{Code, Kind, Outcome};
use crate::operations::calls::call::Call;
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::parameters::values::{Whole, gripper_or_gateway};
use crate::operations::problem::Problem;

operations! {
    /// Propose limits for a recipe
    ///
    /// Proposes limits from the contact widths of the part's newest grips with outcome `PART_HELD`: their mean minus
    /// and plus `k` standard deviations, or 0.01 mm if that is more. Changes nothing: set the limits with the recipe.
    TEACH = POST "/recipes/{part_id}/teach" as "recipe.teach" {
        run: teach, id: "teach_recipe", tag: "recipes", problems: RECIPE,
        answer: "The proposed limits",
    }.needs(Right::Read);
}

/// Grips that are read by default.
const DEFAULT_LAST: u64 = 50;
/// Standard deviations between the mean and a limit by default.
const DEFAULT_K: f64 = 3.0;
const MAX_K: f64 = 10.0;

/// Smallest distance between the mean and a limit. Equal widths have no spread, and no part meets such limits again.
const RESOLUTION_MM: f64 = 0.01;

/// Number of grips that are read. Two have a spread.
type Last = Whole<2, 1000>;

/// Request for proposed limits.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"last": 50, "k": 3.0}))]
pub struct Teach {
    /// Number of the part's newest grips with outcome `PART_HELD` to use; 50 by default.
    last: Option<Last>,
    /// Number of standard deviations between the mean and a limit; 3 by default.
    #[schema(minimum = 0, maximum = 10)]
    k: Option<f64>,
    /// Only grips of this gripper, for values of its own in the recipe.
    #[schema(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$")]
    gripper: Option<String>,
}

/// Proposed limits, and the grips that they come from. The recipe is not changed.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "count": 50, "mean_mm": 20.01, "standard_deviation_mm": 0.05, "accept_min_mm": 19.86, "accept_max_mm": 20.16
}))]
pub struct ProposedLimits {
    /// Number of grips with a contact width.
    #[schema(minimum = 2, maximum = 1000)]
    count: u64,
    /// Mean contact width, in mm.
    mean_mm: f64,
    /// Standard deviation of the contact widths (of a sample), in mm.
    standard_deviation_mm: f64,
    /// Proposed smallest contact width of the right part, in mm.
    accept_min_mm: f64,
    /// Proposed largest contact width of the right part, in mm.
    accept_max_mm: f64,
}

/// A grip record.
#[derive(Deserialize)]
struct GripWidth {
    contact_width_mm: Option<f64>,
}

async fn teach(call: Call<Teach>) -> Result<Json<ProposedLimits>, Problem> {
    let part_id = call.part_id()?;
    let Teach { last, k, gripper } = call.fields()?;
    let gripper = gripper.map(|name| gripper_or_gateway("gripper", &name)).transpose()?;
    let last = last.map_or(Ok(DEFAULT_LAST), |last| last.checked("last"))?;
    let k = k.unwrap_or(DEFAULT_K);
    if !(0.0..=MAX_K).contains(&k) {
        return Err(Problem::out_of_range("k", k, 0.0, MAX_K));
    }
    let filter = Filter {
        gripper,
        part_id: Some(part_id),
        kind: Some(Kind::Grip),
        outcome: Some(Outcome::PartHeld),
        ..Filter::default()
    };
    let limit = Limit::new(last).unwrap_or_default();
    let page = call.gateway.journal.grips(GripQuery { filter, limit, ..GripQuery::default() }).await?;
    let widths = page.bodies.iter().filter_map(|body| serde_json::from_str::<GripWidth>(body).ok()?.contact_width_mm);
    let widths: Distribution = widths.collect();
    let (Some(mean_mm), Some(standard_deviation_mm)) = (widths.mean(), widths.standard_deviation()) else {
        let detail = "fewer than two grips held this part: grip some good parts with its part_id first";
        return Err(Problem::new(Code::NotFound, detail).field("part_id"));
    };
    let distance_mm = (k * standard_deviation_mm).max(RESOLUTION_MM);
    let widest_mm = f64::from(WIDEST_MM);
    Ok(Json(ProposedLimits {
        count: widths.count,
        mean_mm,
        standard_deviation_mm,
        accept_min_mm: (mean_mm - distance_mm).clamp(0.0, widest_mm),
        accept_max_mm: (mean_mm + distance_mm).clamp(0.0, widest_mm),
    }))
}

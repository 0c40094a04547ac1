//! Path of the statistics of grips.

use super::parameters::GripStatisticsQuery;
use super::paths;
use super::responses::JournalProblem;
use crate::operations::statistics::{self, StatisticsOfGrips};

paths! {
    /// Get statistics of grips
    ///
    /// Returns how the grips ended, the spread of their contact widths, forces and times, and with a `part_id` how well
    /// the contact widths fit the limits of the part's recipe. All grips in the journal count, or those that the
    /// parameters select.
    #[utoipa::path(
        get, path = "/grips/statistics", operation_id = "grip_statistics", tag = "journal",
        params(GripStatisticsQuery),
        responses((status = 200, description = "The statistics", body = StatisticsOfGrips), JournalProblem)
    )]
    of_grips => statistics::STATISTICS;
}

//! Objects between the jaws: a part, an obstacle and the end stops. All widths are true distances in mm, which the
//! device knows only once it is referenced.

use serde::{Deserialize, Serialize};

use super::axis::AxisDirection;

/// Stiffness of end stops and obstacles, in N/mm.
pub(crate) const RIGID_N_MM: f64 = 2000.0;

/// Minimum stiffness of a part, in N/mm.
pub(crate) const SOFTEST_N_MM: f64 = 0.1;

/// Speed of a slipping part in mm per step, faster than fingers in contact can follow.
const SLIP_MM_PER_STEP: f64 = 0.05;

/// Distance in mm after which a slipping part has fallen.
const SLIP_MM: f64 = 5.0;

/// Side from which a part is gripped.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GripSide {
    /// The fingers close on the part.
    #[default]
    Outside,
    /// The part is hollow, and the fingers open into it.
    Inside,
}

/// A part between the jaws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Width at which the fingers touch the part, in mm.
    pub width_mm: f64,
    #[serde(default)]
    pub side: GripSide,
    /// Stiffness in N/mm.
    #[serde(default = "ordinary_stiffness_n_mm")]
    pub stiffness_n_mm: f64,
}

/// Default stiffness in N/mm, between foam and steel.
const ORDINARY_N_MM: f64 = 200.0;

fn ordinary_stiffness_n_mm() -> f64 {
    ORDINARY_N_MM
}

impl Part {
    /// A part of ordinary stiffness that the fingers close on.
    #[must_use]
    pub const fn outside(width_mm: f64) -> Self {
        Self { width_mm, side: GripSide::Outside, stiffness_n_mm: ORDINARY_N_MM }
    }

    /// A hollow part of ordinary stiffness that the fingers open into.
    #[must_use]
    pub const fn inside(width_mm: f64) -> Self {
        Self { width_mm, side: GripSide::Inside, stiffness_n_mm: ORDINARY_N_MM }
    }

    fn resists(&self) -> AxisDirection {
        match self.side {
            GripSide::Outside => AxisDirection::Closing,
            GripSide::Inside => AxisDirection::Opening,
        }
    }
}

/// A surface that resists the fingers in one direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface {
    pub at_mm: f64,
    pub stiffness_n_mm: f64,
}

/// First surface in each direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surfaces {
    pub closing: Surface,
    pub opening: Surface,
}

impl Surfaces {
    pub fn against(&self, direction: AxisDirection) -> Surface {
        match direction {
            AxisDirection::Closing => self.closing,
            AxisDirection::Opening => self.opening,
        }
    }

    /// Depth in mm by which fingers at `position_mm` press into the surface in `direction`; negative for a gap.
    pub fn depth_mm(&self, direction: AxisDirection, position_mm: f64) -> f64 {
        (position_mm - self.against(direction).at_mm) * direction.sign()
    }

    /// Force in N on fingers at `position_mm`.
    pub fn force_n(&self, position_mm: f64) -> f64 {
        let closing_n = self.force_against_n(AxisDirection::Closing, position_mm);
        closing_n.max(self.force_against_n(AxisDirection::Opening, position_mm))
    }

    fn force_against_n(&self, direction: AxisDirection, position_mm: f64) -> f64 {
        self.depth_mm(direction, position_mm).max(0.0) * self.against(direction).stiffness_n_mm
    }
}

#[derive(Debug, Clone, Copy)]
struct Placed {
    part: Part,
    /// Whether the fingers enclose the part. A part that is too wide lies beside them until they have opened.
    between_fingers: bool,
    slipped_mm: Option<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Obstacle {
    width_mm: f64,
    resists: AxisDirection,
}

/// The space between the jaws.
#[derive(Debug)]
pub(crate) struct World {
    stroke_mm: f64,
    part: Option<Placed>,
    obstacle: Option<Obstacle>,
}

impl World {
    pub fn new(stroke_mm: f64) -> Self {
        Self { stroke_mm, part: None, obstacle: None }
    }

    pub fn part(&self) -> Option<Part> {
        self.part.map(|placed| placed.part)
    }

    pub fn obstacle_mm(&self) -> Option<f64> {
        self.obstacle.map(|obstacle| obstacle.width_mm)
    }

    pub fn place_part(&mut self, part: Part, position_mm: f64) {
        self.part = Some(Placed { part, between_fingers: false, slipped_mm: None });
        self.notice(position_mm);
    }

    pub fn take_part(&mut self) {
        self.part = None;
    }

    pub fn resize_part(&mut self, width_mm: f64) {
        if let Some(placed) = &mut self.part {
            placed.part.width_mm = width_mm;
        }
    }

    pub fn slip_part(&mut self) {
        if let Some(placed) = &mut self.part {
            placed.slipped_mm = Some(0.0);
        }
    }

    pub fn place_obstacle(&mut self, width_mm: f64, position_mm: f64) {
        let resists = if position_mm >= width_mm { AxisDirection::Closing } else { AxisDirection::Opening };
        self.obstacle = Some(Obstacle { width_mm, resists });
    }

    pub fn remove_obstacle(&mut self) {
        self.obstacle = None;
    }

    /// Whether a part is slipping.
    pub fn is_changing(&self) -> bool {
        self.part.is_some_and(|placed| placed.slipped_mm.is_some())
    }

    /// Moves a slipping part by one step, with the fingers at `position_mm`.
    pub fn step(&mut self, position_mm: f64) {
        if let Some(placed) = &mut self.part
            && let Some(slipped_mm) = &mut placed.slipped_mm
        {
            *slipped_mm += SLIP_MM_PER_STEP;
            placed.part.width_mm += placed.part.resists().sign() * SLIP_MM_PER_STEP;
            if *slipped_mm >= SLIP_MM {
                self.part = None;
            }
        }
        self.notice(position_mm);
    }

    pub fn surfaces(&self) -> Surfaces {
        let mut surfaces = Surfaces {
            closing: Surface { at_mm: 0.0, stiffness_n_mm: RIGID_N_MM },
            opening: Surface { at_mm: self.stroke_mm, stiffness_n_mm: RIGID_N_MM },
        };
        if let Some(placed) = self.part.filter(|placed| placed.between_fingers) {
            let surface =
                Surface { at_mm: placed.part.width_mm, stiffness_n_mm: placed.part.stiffness_n_mm.max(SOFTEST_N_MM) };
            surfaces.meet(placed.part.resists(), surface);
        }
        if let Some(obstacle) = self.obstacle {
            surfaces.meet(obstacle.resists, Surface { at_mm: obstacle.width_mm, stiffness_n_mm: RIGID_N_MM });
        }
        surfaces
    }

    /// Whether the end stop is the first surface in `direction`.
    pub fn ends_in(&self, direction: AxisDirection) -> bool {
        let end_mm = match direction {
            AxisDirection::Closing => 0.0,
            AxisDirection::Opening => self.stroke_mm,
        };
        (self.surfaces().against(direction).at_mm - end_mm).abs() < f64::EPSILON
    }

    fn notice(&mut self, position_mm: f64) {
        if let Some(placed) = &mut self.part {
            let gap_mm = (placed.part.width_mm - position_mm) * placed.part.resists().sign();
            placed.between_fingers |= gap_mm >= 0.0;
        }
    }
}

impl Surfaces {
    /// Keeps the nearer of the current surface and `surface`.
    fn meet(&mut self, direction: AxisDirection, surface: Surface) {
        let first = match direction {
            AxisDirection::Closing => &mut self.closing,
            AxisDirection::Opening => &mut self.opening,
        };
        if (surface.at_mm - first.at_mm) * direction.sign() < 0.0 {
            *first = surface;
        }
    }
}

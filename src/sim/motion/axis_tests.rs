use super::super::world::{Part, World};
use super::*;

fn drive(target_mm: f64) -> Drive {
    Drive { target_mm, speed_mm_s: 100.0, acceleration_mm_s2: 1000.0, force_limit_n: 40.0 }
}

/// Steps until the end. Returns the number of steps, the highest speed and the outcome.
fn run(axis: &mut Axis, drive: &Drive, world: &World) -> (u32, f64, Progress) {
    let (mut steps, mut fastest) = (0, 0.0_f64);
    loop {
        let progress = axis.step(drive, &world.surfaces());
        steps += 1;
        fastest = fastest.max(axis.speed_mm_s.abs());
        if progress != Progress::Moving {
            return (steps, fastest, progress);
        }
        assert!(steps < 100_000);
    }
}

#[test]
fn long_motion_is_trapezoid() {
    let mut axis = Axis::new(100.0);
    let (steps, fastest, progress) = run(&mut axis, &drive(20.0), &World::new(110.0));
    assert_eq!(progress, Progress::Reached);
    assert!((fastest - 100.0).abs() < 1e-9);
    // 0.1 s of acceleration, 0.7 s at constant speed, 0.1 s of deceleration.
    assert!((895..=910).contains(&steps), "{steps}");
    assert!((axis.position_mm - 20.0).abs() < 1e-9 && !axis.is_moving());
}

#[test]
fn short_motion_never_reaches_full_speed() {
    let mut axis = Axis::new(20.0);
    let (steps, fastest, _) = run(&mut axis, &drive(21.0), &World::new(110.0));
    // A triangular profile over 1 mm peaks at sqrt(a * s).
    assert!((fastest - 31.6).abs() < 2.0, "{fastest}");
    assert!((60..=70).contains(&steps), "{steps}");
}

#[test]
fn speed_is_positive_while_opening() {
    let mut axis = Axis::new(20.0);
    axis.step(&drive(30.0), &World::new(110.0).surfaces());
    assert!(axis.speed_mm_s > 0.0);
    let mut axis = Axis::new(20.0);
    axis.step(&drive(10.0), &World::new(110.0).surfaces());
    assert!(axis.speed_mm_s < 0.0);
}

#[test]
fn part_is_pressed_up_to_the_force_limit() {
    let mut world = World::new(110.0);
    world.place_part(Part::outside(50.0), 100.0);
    let mut axis = Axis::new(100.0);
    let (.., progress) = run(&mut axis, &drive(20.0), &world);
    assert_eq!(progress, Progress::Pressing(AxisDirection::Closing));
    assert!((axis.force_n - 40.0).abs() < 1e-6);
    assert!((axis.position_mm - 49.8).abs() < 1e-6, "40 N at 200 N/mm");
    axis.relax(&world.surfaces());
    assert!((axis.position_mm - 50.0).abs() < 1e-9 && axis.force_n.abs() < 1e-9);
}

#[test]
fn too_wide_part_is_not_between_fingers() {
    let mut world = World::new(110.0);
    world.place_part(Part::outside(50.0), 30.0);
    let mut axis = Axis::new(30.0);
    assert_eq!(run(&mut axis, &drive(10.0), &world).2, Progress::Reached);
    world.step(60.0);
    let mut axis = Axis::new(60.0);
    assert_eq!(run(&mut axis, &drive(10.0), &world).2, Progress::Pressing(AxisDirection::Closing));
}

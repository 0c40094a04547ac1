use super::super::world::{Part, World};
use super::*;

fn drive(target_mm: f64) -> Drive {
    Drive { target_mm, speed_mm_s: 100.0, acceleration_mm_s2: 1000.0, force_limit_n: 40.0 }
}

/// Steps to the end: how many, and the highest speed.
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
fn a_long_motion_is_a_trapezoid() {
    let mut axis = Axis::new(100.0);
    let (steps, fastest, progress) = run(&mut axis, &drive(20.0), &World::new(110.0));
    assert_eq!(progress, Progress::Reached);
    assert!((fastest - 100.0).abs() < 1e-9);
    // 0.1 s up, 0.7 s along, 0.1 s down.
    assert!((895..=910).contains(&steps), "{steps}");
    assert!((axis.position_mm - 20.0).abs() < 1e-9 && !axis.is_moving());
}

#[test]
fn a_short_motion_never_reaches_its_speed() {
    let mut axis = Axis::new(20.0);
    let (steps, fastest, _) = run(&mut axis, &drive(21.0), &World::new(110.0));
    // A triangle of 1 mm: the peak is sqrt(a * s).
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
fn a_part_is_pressed_until_the_force_is_there() {
    let mut world = World::new(110.0);
    world.place_part(Part::outside(50.0), 100.0);
    let mut axis = Axis::new(100.0);
    let (.., progress) = run(&mut axis, &drive(20.0), &world);
    assert_eq!(progress, Progress::Pressing(Direction::Closing));
    assert!((axis.force_n - 40.0).abs() < 1e-6);
    assert!((axis.position_mm - 49.8).abs() < 1e-6, "40 N at 200 N/mm");
    axis.relax(&world.surfaces());
    assert!((axis.position_mm - 50.0).abs() < 1e-9 && axis.force_n.abs() < 1e-9);
}

#[test]
fn a_part_wider_than_the_fingers_stand_apart_is_not_between_them() {
    let mut world = World::new(110.0);
    world.place_part(Part::outside(50.0), 30.0);
    let mut axis = Axis::new(30.0);
    assert_eq!(run(&mut axis, &drive(10.0), &world).2, Progress::Reached);
    world.step(60.0);
    let mut axis = Axis::new(60.0);
    assert_eq!(run(&mut axis, &drive(10.0), &world).2, Progress::Pressing(Direction::Closing));
}

use std::sync::Arc;

use super::*;
use crate::journal::{JournalLocation, Retention};
use crate::model::{Door, RecipeDescription, RecipeValues};

fn recipe(part_id: &str, number: u8, width_mm: f64) -> Recipe {
    Recipe {
        part_id: PartId::new(part_id).unwrap(),
        number: RecipeNumber::new(number).unwrap(),
        values: RecipeValues { width_mm: Some(width_mm), ..RecipeValues::default() },
        description: RecipeDescription::new("").unwrap(),
        grippers: [("right".parse().unwrap(), RecipeValues { force_n: Some(30.0), ..RecipeValues::default() })].into(),
    }
}

fn gateway() -> Name {
    "wsg".parse().unwrap()
}

fn any(recipe: Recipe) -> (Recipe, ExpectedVersion) {
    (recipe, ExpectedVersion::Any)
}

fn recipes() -> (Recipes, Client) {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    (Recipes::new(gateway(), journal, &[]), Client::new("mes", Door::Http))
}

fn listed(recipes: &Recipes) -> Vec<(u8, String, u64)> {
    let shown =
        |one: Arc<RecipeVersion>| (one.recipe.number.get(), one.recipe.part_id.as_str().to_owned(), one.version);
    recipes.all().into_iter().map(shown).collect()
}

#[tokio::test]
async fn versions_are_never_used_twice() {
    let (recipes, mes) = recipes();
    let set = |recipe| recipes.set(vec![any(recipe)], &mes).unwrap();
    set(recipe("A", 1, 20.0)).durable.unwrap().await.unwrap();
    assert!(set(recipe("A", 1, 20.0)).durable.is_none(), "an unchanged recipe is no new version");
    assert_eq!(set(recipe("A", 1, 21.0)).versions[0].version, 2);
    let a = PartId::new("A").unwrap();
    let removed = recipes.remove(&a, ExpectedVersion::Exactly(2), &mes).unwrap().unwrap();
    assert_eq!((removed.versions[0].version, removed.versions[0].removed), (3, true));
    assert_eq!((listed(&recipes), recipes.remove(&a, ExpectedVersion::Any, &mes).unwrap().is_none()), (vec![], true));
    set(recipe("A", 1, 20.0));
    assert_eq!(listed(&recipes), [(1, "A".to_owned(), 4)]);
    let versions: Vec<_> = recipes.versions(&a).iter().map(|one| (one.version, one.recipe.values.width_mm)).collect();
    assert_eq!(versions, [(4, Some(20.0)), (3, Some(21.0)), (2, Some(21.0)), (1, Some(20.0))]);
}

#[tokio::test]
async fn expected_version_is_required() {
    let (recipes, mes) = recipes();
    let set = |width_mm, expected| recipes.set(vec![(recipe("A", 1, width_mm), expected)], &mes).map(|_| ());
    let changed = |version| Err(RecipeConflict::OtherVersion { part_id: PartId::new("A").unwrap(), version });
    assert_eq!(set(20.0, ExpectedVersion::Present), changed(None));
    assert_eq!(set(20.0, ExpectedVersion::Exactly(1)), changed(None));
    assert_eq!(set(20.0, ExpectedVersion::Absent), Ok(()));
    assert_eq!(set(21.0, ExpectedVersion::Absent), changed(Some(1)));
    assert_eq!(set(21.0, ExpectedVersion::Exactly(1)), Ok(()));
    assert_eq!(set(22.0, ExpectedVersion::Exactly(1)), changed(Some(2)));
    assert_eq!(set(22.0, ExpectedVersion::Present), Ok(()));
}

#[tokio::test]
async fn number_belongs_to_one_part() {
    let (recipes, mes) = recipes();
    let set = |list: &[(&str, u8)]| {
        let list = list.iter().map(|(part_id, number)| any(recipe(part_id, *number, 20.0))).collect();
        recipes.set(list, &mes).map(|change| change.versions.len())
    };
    assert_eq!(set(&[("A", 1), ("B", 2)]), Ok(2));
    let taken = |number, by| {
        Err(RecipeConflict::NumberTaken { number: RecipeNumber::new(number).unwrap(), by: PartId::new(by).unwrap() })
    };
    assert_eq!(set(&[("C", 3), ("D", 2)]), taken(2, "B"));
    assert_eq!(set(&[("C", 3), ("D", 3)]), taken(3, "C"));
    assert_eq!(listed(&recipes).len(), 2, "a refused request changes nothing");
    assert_eq!(set(&[("A", 2), ("B", 1)]), Ok(2), "two recipes change their numbers");
    let numbers: Vec<_> = listed(&recipes).into_iter().map(|(number, part_id, _)| (number, part_id)).collect();
    assert_eq!(numbers, [(1, "B".to_owned()), (2, "A".to_owned())]);
}

#[tokio::test]
async fn recipes_survive_a_restart() {
    let path = std::env::temp_dir().join(format!("wsg-recipes-{}", uuid::Uuid::now_v7()));
    let open = || Journal::open(JournalLocation::File(path.clone()), Retention::default()).unwrap();
    let mes = Client::new("mes", Door::Http);
    let (journal, _) = open();
    let before = Recipes::new(gateway(), journal.clone(), &[]);
    before.set(vec![any(recipe("A", 1, 20.0)), any(recipe("B", 2, 30.0))], &mes).unwrap();
    before.set(vec![any(recipe("A", 7, 20.0))], &mes).unwrap();
    before.remove(&PartId::new("B").unwrap(), ExpectedVersion::Any, &mes).unwrap();
    journal.close().await.unwrap();
    let known = before.all();
    drop((before, journal));
    let (journal, recovered) = open();
    let after = Recipes::new("cell-7".parse().unwrap(), journal, &recovered.memory);
    assert_eq!(after.all(), known);
    let next = after.set(vec![any(recipe("C", 2, 30.0))], &mes).unwrap();
    assert_eq!(next.versions[0].version, 5, "versions continue after those of removed recipes");
    after.set(vec![any(recipe("A", 2, 20.0)), any(recipe("C", 7, 30.0))], &mes).unwrap();
    let known = after.all();
    after.journal.close().await.unwrap();
    drop(after);
    let (journal, recovered) = open();
    assert_eq!(recovered.memory.iter().filter(|state| state.key == PersistedKey::Recipes).count(), 1);
    assert_eq!(Recipes::new(gateway(), journal, &recovered.memory).all(), known, "two recipes have swapped numbers");
    for end in ["", "-wal", "-shm", "-lock"] {
        let _ = std::fs::remove_file(format!("{}{end}", path.display()));
    }
}

#[test]
fn current_versions_outlive_newer_ones_of_other_recipes() {
    let (mut known, by) = (KnownRecipes::default(), Arc::from("mes"));
    let mut set = |recipe| known.set(vec![any(recipe)], &by, Now::read().wall).unwrap();
    set(recipe("A", 1, 20.0));
    for width_mm in 0..1101 {
        set(recipe("B", 2, f64::from(width_mm)));
    }
    let versions = |part_id: &str| {
        let of_part = known.all().rev().filter(|version| version.recipe.part_id.as_str() == part_id);
        of_part.map(|version| version.version).collect::<Vec<_>>()
    };
    assert_eq!(versions("A"), [1]);
    assert_eq!(versions("B"), (104..=1102).rev().collect::<Vec<_>>());
}

#[test]
fn time_of_a_version_always_has_milliseconds() {
    let changed_at = "2026-11-30T17:46:53.670Z";
    let at = changed_at.parse().unwrap();
    let recipe = recipe("A", 1, 20.0);
    let version = RecipeVersion { version: 1, changed_at: at, changed_by: "mes".into(), removed: false, recipe };
    assert_eq!(serde_json::to_value(version).unwrap()["changed_at"], changed_at);
}

//! The recipes in memory: the newest versions, and which of them are current.

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Timestamp;

use super::version::RecipeVersion;
use crate::model::{PartId, Recipe, RecipeNumber};

/// Maximum number of versions. Beyond it, the oldest one is dropped that is not current.
const MAX_VERSIONS: usize = 1000;

#[derive(Debug, Default)]
pub(super) struct KnownRecipes {
    /// Versions by their numbers, those of removals included.
    versions: BTreeMap<u64, Arc<RecipeVersion>>,
    /// Current version of each recipe.
    current: BTreeMap<RecipeNumber, u64>,
}

/// Version of a recipe that a change expects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ExpectedVersion {
    #[default]
    Any,
    /// This version.
    Exactly(u64),
    /// A recipe of any version.
    Present,
    /// No recipe.
    Absent,
}

/// Reason that recipes cannot be changed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecipeConflict {
    /// The number belongs to the recipe of another part.
    NumberTaken { number: RecipeNumber, by: PartId },
    /// The recipe has another version than expected, or does not exist if `version` is absent.
    OtherVersion { part_id: PartId, version: Option<u64> },
}

/// Result of a change.
#[derive(Debug, Default)]
pub(super) struct ChangedRecipes {
    /// The versions of the recipes that were set, new or not.
    pub versions: Vec<Arc<RecipeVersion>>,
    pub new: Vec<Arc<RecipeVersion>>,
    pub has_new_recipe: bool,
}

impl KnownRecipes {
    /// Takes the versions that were persisted.
    pub(super) fn restored(versions: impl IntoIterator<Item = RecipeVersion>) -> Self {
        let mut sorted: Vec<_> = versions.into_iter().collect();
        sorted.sort_by_key(|version| version.version);
        let mut this = Self::default();
        for version in sorted {
            this.add(Arc::new(version));
        }
        this
    }

    pub(super) fn all(&self) -> impl DoubleEndedIterator<Item = &Arc<RecipeVersion>> {
        self.versions.values()
    }

    pub(super) fn current(&self) -> impl Iterator<Item = &Arc<RecipeVersion>> {
        self.current.values().filter_map(|version| self.versions.get(version))
    }

    pub(super) fn of_number(&self, number: RecipeNumber) -> Option<&Arc<RecipeVersion>> {
        self.versions.get(self.current.get(&number)?)
    }

    pub(super) fn of_part(&self, part_id: &PartId) -> Option<&Arc<RecipeVersion>> {
        self.current().find(|current| current.recipe.part_id == *part_id)
    }

    pub(super) fn set(
        &mut self,
        recipes: Vec<(Recipe, ExpectedVersion)>,
        by: &Arc<str>,
        at: Timestamp,
    ) -> Result<ChangedRecipes, RecipeConflict> {
        for (index, (recipe, expected)) in recipes.iter().enumerate() {
            self.check_version(&recipe.part_id, *expected)?;
            if let Some(owner) = self.owner(recipe, &recipes, index) {
                return Err(RecipeConflict::NumberTaken { number: recipe.number, by: owner.clone() });
            }
        }
        let mut changed = ChangedRecipes::default();
        for (recipe, _) in recipes {
            changed.has_new_recipe |= self.of_part(&recipe.part_id).is_none();
            let unchanged = self.of_number(recipe.number).filter(|current| current.recipe == recipe).cloned();
            let version = unchanged.unwrap_or_else(|| self.change(recipe, false, by, at, &mut changed));
            changed.versions.push(version);
        }
        Ok(changed)
    }

    pub(super) fn remove(
        &mut self,
        part_id: &PartId,
        expected: ExpectedVersion,
        by: &Arc<str>,
        at: Timestamp,
    ) -> Result<Option<ChangedRecipes>, RecipeConflict> {
        self.check_version(part_id, expected)?;
        let Some(current) = self.of_part(part_id).cloned() else { return Ok(None) };
        let mut changed = ChangedRecipes::default();
        let removed = self.change(current.recipe.clone(), true, by, at, &mut changed);
        changed.versions.push(removed);
        Ok(Some(changed))
    }

    fn check_version(&self, part_id: &PartId, expected: ExpectedVersion) -> Result<(), RecipeConflict> {
        let version = self.of_part(part_id).map(|current| current.version);
        let is_met = match expected {
            ExpectedVersion::Any => true,
            ExpectedVersion::Exactly(expected) => version == Some(expected),
            ExpectedVersion::Present => version.is_some(),
            ExpectedVersion::Absent => version.is_none(),
        };
        if is_met { Ok(()) } else { Err(RecipeConflict::OtherVersion { part_id: part_id.clone(), version }) }
    }

    /// Returns the other part that has the number of a recipe, or gets it earlier in the same request.
    fn owner<'a>(
        &'a self,
        recipe: &Recipe,
        recipes: &'a [(Recipe, ExpectedVersion)],
        index: usize,
    ) -> Option<&'a PartId> {
        let earlier = recipes[..index].iter().find(|(earlier, _)| earlier.number == recipe.number);
        if let Some((earlier, _)) = earlier {
            return Some(&earlier.part_id);
        }
        let current = &self.of_number(recipe.number)?.recipe.part_id;
        // The old number of a part that the same request sets does not count.
        let is_set = recipes.iter().any(|(other, _)| other.part_id == *current);
        if is_set { None } else { Some(current) }
    }

    fn change(
        &mut self,
        recipe: Recipe,
        removed: bool,
        by: &Arc<str>,
        at: Timestamp,
        changed: &mut ChangedRecipes,
    ) -> Arc<RecipeVersion> {
        let version = self.versions.last_key_value().map_or(1, |(newest, _)| newest + 1);
        let added = Arc::new(RecipeVersion { version, changed_at: at, changed_by: by.clone(), removed, recipe });
        self.add(added.clone());
        changed.new.push(added.clone());
        added
    }

    /// Adds the newest version. Its part leaves its old number, and its number the old part.
    fn add(&mut self, added: Arc<RecipeVersion>) {
        let old = self.of_part(&added.recipe.part_id).map(|old| old.recipe.number);
        if let Some(old) = old {
            self.current.remove(&old);
        }
        if !added.removed {
            self.current.insert(added.recipe.number, added.version);
        }
        self.versions.insert(added.version, added);
        while self.versions.len() > MAX_VERSIONS {
            // The newest version stays, even if it is a removal: the next one continues from it.
            let newest = self.versions.last_key_value().map(|(newest, _)| *newest);
            let mut versions = self.versions.keys().copied().filter(|version| Some(*version) != newest);
            let oldest = versions.find(|version| !self.current.values().any(|current| current == version));
            let Some(oldest) = oldest else { return };
            self.versions.remove(&oldest);
        }
    }
}

//! Recipes, shared by all clients: by part for an MES, and by number for a PLC.
//!
//! A change is a new version, and versions are never used twice, so that a grip's record names the values that it was
//! made with. The newest versions are persisted together, and each change is an event of kind `recipe`.

mod store;
#[cfg(test)]
mod tests;
mod version;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;
use tokio::sync::oneshot;

use crate::gripper::Now;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::Journal;
use crate::model::{
    Client, Detail, Event, Name, PartId, PersistedKey, PersistedState, Recipe, RecipeEvent, RecipeNumber, RecipeStep,
};
use store::{ChangedRecipes, KnownRecipes};

pub use store::{ExpectedVersion, RecipeConflict};
pub use version::RecipeVersion;

/// The recipes of this gateway.
#[derive(Debug)]
pub struct Recipes {
    gateway: Name,
    journal: Journal,
    known: Mutex<KnownRecipes>,
}

/// A change of recipes that may not be durable yet.
#[derive(Debug)]
pub struct RecipeChange {
    /// The versions after the change, in the order of the request.
    pub versions: Vec<Arc<RecipeVersion>>,
    /// Whether a part got its first recipe, or one again after a removal.
    pub has_new_recipe: bool,
    /// Resolves once the change is durable, and fails if the journal cannot be written. Absent if nothing had to change.
    pub durable: Option<oneshot::Receiver<()>>,
}

impl Recipes {
    /// Continues with the recipes that earlier runs persisted.
    #[must_use]
    pub fn new(gateway: Name, journal: Journal, persisted: &[PersistedState]) -> Self {
        let mut restored: Vec<RecipeVersion> = Vec::new();
        for state in persisted.iter().filter(|state| state.key == PersistedKey::Recipes) {
            let values: Vec<Value> = serde_json::from_str(state.value.as_deref().unwrap_or("[]")).unwrap_or_default();
            for value in values {
                match serde_json::from_value(value) {
                    Ok(version) => restored.push(version),
                    Err(error) => tracing::warn!(%error, "version of a recipe not restored: unknown format"),
                }
            }
        }
        let this = Self { gateway, journal, known: Mutex::new(KnownRecipes::restored(restored)) };
        // The gateway had another name in that run.
        for state in
            persisted.iter().filter(|state| state.key == PersistedKey::Recipes && state.gripper != this.gateway)
        {
            this.persist(&this.known());
            this.journal.record(Record::Persisted(PersistedState { value: None, ..state.clone() }));
        }
        this
    }

    /// Returns all recipes, by number.
    #[must_use]
    pub fn all(&self) -> Vec<Arc<RecipeVersion>> {
        self.known().current().cloned().collect()
    }

    #[must_use]
    pub fn of_number(&self, number: RecipeNumber) -> Option<Arc<RecipeVersion>> {
        self.known().of_number(number).cloned()
    }

    #[must_use]
    pub fn of_part(&self, part_id: &PartId) -> Option<Arc<RecipeVersion>> {
        self.known().of_part(part_id).cloned()
    }

    /// Returns the kept versions of a part's recipe, the newest first.
    #[must_use]
    pub fn versions(&self, part_id: &PartId) -> Vec<Arc<RecipeVersion>> {
        self.known().all().rev().filter(|version| version.recipe.part_id == *part_id).cloned().collect()
    }

    /// Creates or changes recipes: all of them, or none if one is refused.
    ///
    /// # Errors
    /// [`RecipeConflict`], if a number belongs to another recipe, or a recipe does not have the expected version.
    pub fn set(&self, recipes: Vec<(Recipe, ExpectedVersion)>, by: &Client) -> Result<RecipeChange, RecipeConflict> {
        let mut known = self.known();
        let changed = known.set(recipes, &by.subject, Now::read().wall)?;
        Ok(self.note(&known, changed, by))
    }

    /// Removes the recipe of a part. `None` if it has none.
    ///
    /// # Errors
    /// [`RecipeConflict`], if the recipe does not have the expected version.
    pub fn remove(
        &self,
        part_id: &PartId,
        expected: ExpectedVersion,
        by: &Client,
    ) -> Result<Option<RecipeChange>, RecipeConflict> {
        let mut known = self.known();
        let changed = known.remove(part_id, expected, &by.subject, Now::read().wall)?;
        Ok(changed.map(|changed| self.note(&known, changed, by)))
    }

    /// Persists and records a change. Once the last event is durable, everything before it is too.
    fn note(&self, known: &KnownRecipes, changed: ChangedRecipes, by: &Client) -> RecipeChange {
        let ChangedRecipes { versions, new, has_new_recipe } = changed;
        if !new.is_empty() {
            self.persist(known);
        }
        let mut durable = None;
        for (index, version) in new.iter().enumerate() {
            let event = Event::new(version.changed_at, None, Detail::Recipe(Box::new(event(version)))).by(by);
            let waiter = (index + 1 == new.len()).then(|| {
                let (waiter, receiver) = oneshot::channel();
                durable = Some(receiver);
                waiter
            });
            self.journal.record(Record::Event(event, waiter));
        }
        RecipeChange { versions, has_new_recipe, durable }
    }

    fn persist(&self, known: &KnownRecipes) {
        let versions: Vec<_> = known.all().collect();
        match serde_json::to_string(&versions) {
            Ok(value) => self.journal.record(Record::Persisted(PersistedState {
                gripper: self.gateway.clone(),
                key: PersistedKey::Recipes,
                value: Some(value),
            })),
            Err(error) => tracing::error!(%error, "recipes not persisted: they cannot be encoded as JSON"),
        }
    }

    fn known(&self) -> MutexGuard<'_, KnownRecipes> {
        // A panic under the lock leaves at most one change unrecorded.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn event(version: &RecipeVersion) -> RecipeEvent {
    RecipeEvent {
        event: if version.removed { RecipeStep::RecipeRemoved } else { RecipeStep::RecipeSet },
        recipe: version.recipe.number,
        recipe_version: version.version,
        definition: version.recipe.clone(),
    }
}

//! Lists of events and grip records, as HTTP and other gateways request them: by the query of an address.

use http::Uri;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::value::{RawValue, to_raw_value};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;
use uuid::Uuid;

use super::gateway::Gateway;
use super::parameters::query_string::QueryString;
use super::parameters::values::{integer, text};
use super::problem::Problem;
use crate::fleet::{EVENTS, GRIPS};
use crate::journal::{Cursor, EventKind, Filter, Limit, Page, Query};
use crate::model::{Code, Event, GripRecord, Kind, PartId};

/// Digits of the largest accepted cursor, beyond the events that any journal will have.
const MAX_CURSOR_DIGITS: usize = 18;

/// Most records on a page that another gateway requests.
const MAX_SHORT: f64 = 100.0;

/// A list of the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordList {
    Events,
    Grips,
}

/// Kinds of grip records.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum GripKinds {
    /// Every kind.
    All,
    /// Homings.
    Home,
    /// Moves.
    Move,
    /// Grips.
    #[default]
    Grip,
    /// Releases.
    Release,
    /// Reference grips, on gauges.
    Reference,
}

impl From<GripKinds> for Option<Kind> {
    fn from(kinds: GripKinds) -> Self {
        match kinds {
            GripKinds::All => None,
            GripKinds::Home => Some(Kind::Home),
            GripKinds::Move => Some(Kind::Move),
            GripKinds::Grip => Some(Kind::Grip),
            GripKinds::Release => Some(Kind::Release),
            GripKinds::Reference => Some(Kind::Reference),
        }
    }
}

/// An event, with the common fields and those of its kind.
#[derive(Serialize, ToSchema)]
#[schema(as = StoredEvent)]
#[allow(dead_code, reason = "only describes the JSON that the journal stores")]
pub struct EventBody {
    /// Sequence number of the event.
    #[schema(minimum = 1)]
    seq: i64,
    #[serde(flatten)]
    event: Event,
}

/// A motion's measurements, without the curve.
#[derive(Serialize, ToSchema)]
#[schema(as = StoredGripRecord)]
#[allow(dead_code, reason = "only describes the JSON that the journal stores")]
pub struct GripBody {
    /// Sequence number of the grip record.
    #[schema(minimum = 1)]
    seq: i64,
    #[serde(flatten)]
    record: GripRecord,
    /// Time at which the gripped part was lost; null if it was not lost.
    #[schema(value_type = Option<String>, required, format = DateTime)]
    part_lost_at: Option<String>,
}

/// A page of events.
#[derive(Serialize, ToSchema)]
pub struct EventPage<'a> {
    #[schema(value_type = Vec<EventBody>)]
    events: Vec<&'a RawValue>,
    /// Cursor of the next page. On the last page it is null, or with `order=oldest` the cursor of later records.
    #[schema(required)]
    next_cursor: Option<&'a str>,
    /// Whether another page follows.
    has_more: bool,
    /// Id of the journal. Cursors and sequence numbers of another journal mean other records.
    journal_id: Uuid,
}

/// A page of grip records.
#[derive(Serialize, ToSchema)]
pub struct GripPage<'a> {
    #[schema(value_type = Vec<GripBody>)]
    grips: Vec<&'a RawValue>,
    /// Cursor of the next page. On the last page it is null, or with `order=oldest` the cursor of later records.
    #[schema(required)]
    next_cursor: Option<&'a str>,
    /// Whether another page follows.
    has_more: bool,
    /// Id of the journal. Cursors and sequence numbers of another journal mean other records.
    journal_id: Uuid,
}

impl RecordList {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Events => EVENTS,
            Self::Grips => GRIPS,
        }
    }

    /// Reads a page that another gateway can forward: it has at most 100 records.
    pub async fn short_page(self, gateway: &Gateway, uri: &Uri) -> Result<Page, Problem> {
        let limit = QueryString::of(uri).parsed("limit", "a whole number", |text| text.parse::<f64>().ok())?;
        match limit.filter(|limit| *limit > MAX_SHORT) {
            Some(limit) => Err(Problem::out_of_range("limit", limit, 1.0, MAX_SHORT)),
            None => self.page(gateway, uri).await,
        }
    }

    /// Reads a page. The query has the filters.
    pub async fn page(self, gateway: &Gateway, uri: &Uri) -> Result<Page, Problem> {
        let journal = &gateway.journal;
        Ok(match self {
            Self::Events => journal.events(query(uri, &["command_id"], |kind: Option<EventKind>| kind)?).await?,
            Self::Grips => journal.grips(query(uri, &[], kind_of_grips)?).await?,
        })
    }

    /// Returns the JSON of a page.
    pub fn body(self, gateway: &Gateway, page: &Page) -> Result<Box<RawValue>, Problem> {
        let records = raw(page)?;
        let next_cursor = next_cursor(page);
        let has_more = page.next_cursor.is_some();
        let journal_id = gateway.journal.id();
        let body = match self {
            Self::Events => to_raw_value(&EventPage { events: records, next_cursor, has_more, journal_id }),
            Self::Grips => to_raw_value(&GripPage { grips: records, next_cursor, has_more, journal_id }),
        };
        body.map_err(|_| Problem::internal())
    }
}

fn kind_of_grips(kinds: Option<GripKinds>) -> Option<Kind> {
    kinds.unwrap_or_default().into()
}

/// Parses a request's query. `kind` maps the word that it gives to the kind of the records.
fn query<W: DeserializeOwned + Serialize + VariantArray, K>(
    uri: &Uri,
    more: &[&str],
    kind: fn(Option<W>) -> Option<K>,
) -> Result<Query<K>, Problem> {
    let known = ["gripper", "kind", "part_id", "part_prefix", "outcome", "from", "to", "limit", "cursor", "order"];
    let given = QueryString::of(uri).only(&[&known, more].concat())?;
    let limit = match given.parsed("limit", "a whole number", |text| text.parse::<f64>().ok())? {
        // `integer` has checked the range, so `Limit::new` succeeds.
        Some(number) => Limit::new(integer("limit", number, 1..=1000)?).unwrap_or_default(),
        None => Limit::default(),
    };
    Ok(Query {
        filter: Filter {
            gripper: given.parsed("gripper", "a gripper's name", |text| text.parse().ok())?,
            kind: kind(given.word("kind")?),
            part_id: part(&given, "part_id")?,
            part_prefix: part(&given, "part_prefix")?,
            outcome: given.word("outcome")?,
            command_id: given.parsed("command_id", "a command's id, a UUID", |text| text.parse().ok())?,
        },
        from: given.time("from")?,
        to: given.time("to")?,
        limit,
        cursor: given.parsed("cursor", "next_cursor of the previous page", cursor)?,
        order: given.word("order")?.unwrap_or_default(),
    })
}

fn part(given: &QueryString, field: &str) -> Result<Option<PartId>, Problem> {
    given.one(field)?.map(|part| text(field, part)).transpose()
}

fn cursor(text: &str) -> Option<Cursor> {
    let is_ours = text.len() <= MAX_CURSOR_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
    is_ours.then(|| text.parse().ok()).flatten()
}

fn raw(page: &Page) -> Result<Vec<&RawValue>, Problem> {
    let records: Result<Vec<&RawValue>, _> = page.bodies.iter().map(|body| serde_json::from_str(body)).collect();
    records.map_err(|error| Problem::new(Code::JournalDown, format!("a record of the journal is damaged: {error}")))
}

/// Cursor of the next page, or of later records.
pub fn next_cursor(page: &Page) -> Option<&str> {
    page.next_cursor.as_deref().or(page.resume_cursor.as_deref())
}

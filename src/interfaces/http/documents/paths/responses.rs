//! Problem responses of the operations, for the OpenAPI document: each described once and referenced.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};
use utoipa::openapi::{Components, ContentBuilder, HeaderBuilder, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{IntoResponses, ToSchema};

use crate::operations::Members;
use crate::operations::calls::problem_sets;

/// Statuses of problems: status, name in the document, and description with the codes.
const PROBLEMS: &[(&str, &str, &str)] = &[
    ("400", "Malformed", "`malformed`: the request is invalid; `field` names the faulty field"),
    ("401", "Unauthorized", "`unauthorized`: the request needs a valid credential"),
    (
        "403",
        "Forbidden",
        "`foreign_host`, `foreign_origin`: the request's Host or Origin is not allowed; `forbidden`: the client's role or \
         grippers do not allow the request",
    ),
    ("404", "NotFound", "`not_found`: the path, gripper or command does not exist"),
    ("408", "RequestTimeout", "`request_timeout`: the body did not arrive in time"),
    (
        "409",
        "Conflict",
        "`fast_stop`, `not_referenced`, `already_running`, `release_first`, `lease_held`, `stale_lease`, `stale_fast_stop`, \
         `fast_stop_unconfirmed`, `request_id_reused`, `name_taken`, `invalid_configuration`, `number_taken`, `unknown_past`, `reserved`: not possible in the current \
         state; the problem's members name the cause",
    ),
    (
        "412",
        "PreconditionFailed",
        "`precondition_failed`: the recipe does not have the version that the request expects",
    ),
    ("413", "TooLarge", "`too_large`: the body is larger than `max` bytes"),
    ("415", "UnsupportedEncoding", "`unsupported_encoding`: the body is compressed"),
    (
        "422",
        "Unprocessable",
        "`out_of_range`: a value is outside `min` to `max`; `device_refused`: the device refused the request with \
         `device_status`",
    ),
    (
        "429",
        "Overloaded",
        "`overloaded`: too many requests are in progress or wait for this gripper, too many WebSockets are open, \
         the client changes recipes too fast, or the device tag was written less than a second ago. Try again later",
    ),
    ("500", "Internal", "`internal`: internal error; see the gateway's log"),
    ("502", "DeviceProtocol", "`device_protocol`: the device's reply is invalid"),
    (
        "503",
        "LinkDown",
        "`link_down`: there is no working link to the device; `journal_down`: the journal can't be written or read; \
         `gateway_gone`: the gateway that owns the gripper is gone, and nothing was sent to it",
    ),
    (
        "504",
        "DeviceTimeout",
        "`device_timeout`: the device did not reply in time; `gateway_timeout`: the gateway that owns the gripper did \
         not reply in time, and the outcome is unknown",
    ),
];

/// Further problems of an operation on a gripper of another gateway.
pub const FORWARDED: &[u16] = &[404, 429, 503, 504];

/// Sets of problems of the routes without an operation, for utoipa's macro.
macro_rules! sets {
    ($($name:ident $statuses:expr;)*) => {$(
        pub struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<Response>> {
                named($statuses).map(|(status, name)| (status.to_owned(), RefOr::Ref(Ref::from_response_name(name)))).collect()
            }
        }
    )*};
}

sets! {
    AnyProblem problem_sets::ANY;
    SessionProblem problem_sets::WEBHOOK;
    RecipeProblem problem_sets::RECIPE;
    SocketProblem problem_sets::ANY;
    JournalProblem problem_sets::JOURNAL;
}

/// Returns references to the problems with these statuses.
pub fn references(statuses: &[u16]) -> Map<String, Value> {
    let mut references = Map::new();
    for (status, name) in named(statuses) {
        references.insert(status.to_owned(), json!({"$ref": format!("#/components/responses/{name}")}));
    }
    references
}

fn named(statuses: &[u16]) -> impl Iterator<Item = (&'static str, &'static str)> {
    let listed =
        PROBLEMS.iter().filter(move |(status, ..)| status.parse().is_ok_and(|status| statuses.contains(&status)));
    listed.map(|(status, name, _)| (*status, *name))
}

/// Adds the responses that the operations refer to.
pub fn describe(components: &mut Components) {
    let schema = Ref::from_schema_name(Members::name());
    for (_, name, description) in PROBLEMS {
        let content = ContentBuilder::new().schema(Some(schema.clone())).build();
        let mut response =
            ResponseBuilder::new().description(*description).content("application/problem+json", content);
        if *name == "Overloaded" {
            let seconds = HeaderBuilder::new().description(Some("Time to wait before the next attempt, in seconds"));
            response = response.header("Retry-After", seconds.build());
        }
        let response = response.build();
        components.responses.insert((*name).to_owned(), response.into());
    }
}

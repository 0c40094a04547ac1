//! Problem responses of the operations, for the OpenAPI document: each described once and referenced.

use std::collections::BTreeMap;

use utoipa::openapi::{Components, ContentBuilder, HeaderBuilder, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{IntoResponses, ToSchema};

use crate::operations::Members;

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
         `fast_stop_unconfirmed`, `request_id_reused`, `name_taken`, `invalid_configuration`, `number_taken`: not possible in the current \
         state; the problem's members name the cause",
    ),
    (
        "412",
        "PreconditionFailed",
        "`precondition_failed`: the recipe does not have the version that the request expects",
    ),
    ("413", "TooLarge", "`too_large`: the body is larger than `max` bytes"),
    (
        "422",
        "Unprocessable",
        "`out_of_range`: a value is outside `min` to `max`; `device_refused`: the device refused the request with \
         `device_status`",
    ),
    (
        "429",
        "Overloaded",
        "`overloaded`: too many requests are in progress or wait for this gripper, too many WebSockets are open, or the \
         device tag was written less than a second ago. Try again later",
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
pub const FORWARDED: &[(&str, &str)] =
    &[("404", "NotFound"), ("429", "Overloaded"), ("503", "LinkDown"), ("504", "DeviceTimeout")];

macro_rules! sets {
    ($($(#[$doc:meta])* $name:ident [$($status:literal)*];)*) => {$(
        $(#[$doc])*
        pub struct $name;

        impl IntoResponses for $name {
            fn responses() -> BTreeMap<String, RefOr<Response>> {
                references(&[$($status),*])
            }
        }
    )*};
}

sets! {
    /// Problems of a FAST STOP of one gripper, which is never refused in favour of others.
    FastStopProblem ["400" "401" "403" "404" "422" "500"];
    /// Problems of a FAST STOP of several grippers.
    FastStopsProblem ["400" "401" "403" "500"];
    /// Problems that every other operation can have.
    AnyProblem ["400" "401" "403" "429" "500"];
    /// Problems of operations that read the gateway's own knowledge of a gripper.
    GripperProblem ["400" "401" "403" "404" "422" "429" "500"];
    /// Problems of operations that change the gateway's own knowledge of a gripper.
    KnowledgeProblem ["400" "401" "403" "404" "408" "413" "422" "429" "500" "503"];
    /// Problems of operations that ask a gripper's actor about its commands.
    CommandProblem ["400" "401" "403" "404" "408" "413" "422" "429" "500" "503"];
    /// Problems of operations that request the lease.
    LeaseProblem ["400" "401" "403" "404" "408" "409" "413" "422" "429" "500" "503"];
    /// Problems of testing a webhook.
    WebhookProblem ["400" "401" "403" "404" "408" "413" "422" "429" "500"];
    /// Problems of reading the configuration again.
    ReloadProblem ["400" "401" "403" "408" "409" "413" "429" "500"];
    /// Problems of signing in and out.
    SessionProblem ["400" "401" "403" "404" "408" "413" "422" "429" "500"];
    /// Problems of changing recipes.
    RecipeProblem ["400" "401" "403" "404" "408" "409" "412" "413" "422" "429" "500" "503"];
    /// Problems of copying recipes to another gateway.
    CopyProblem ["400" "401" "403" "404" "408" "409" "412" "413" "422" "429" "500" "502" "503" "504"];
    /// Problems of opening a WebSocket.
    SocketProblem ["400" "401" "403" "429" "500"];
    /// Problems of reading the journal.
    JournalProblem ["400" "401" "403" "404" "422" "429" "500" "503"];
    /// Problems of operations that send requests to the device.
    DeviceProblem ["400" "401" "403" "404" "408" "409" "413" "422" "429" "500" "502" "503" "504"];
    /// Problems of motions that can follow a recipe.
    RecipeMotionProblem ["400" "401" "403" "404" "408" "409" "412" "413" "422" "429" "500" "502" "503" "504"];
}

fn references(statuses: &[&str]) -> BTreeMap<String, RefOr<Response>> {
    PROBLEMS
        .iter()
        .filter(|(status, ..)| statuses.contains(status))
        .map(|(status, name, _)| ((*status).to_owned(), RefOr::Ref(Ref::from_response_name(*name))))
        .collect()
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

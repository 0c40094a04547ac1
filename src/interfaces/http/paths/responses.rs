//! Which problems an operation can answer with, for the OpenAPI document: each described once, and referred to.

use std::collections::BTreeMap;

use utoipa::openapi::{Components, ContentBuilder, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{IntoResponses, ToSchema};

use crate::operations::Members;

/// Every status that a problem can have: its name in the document, and the codes that come with it.
const PROBLEMS: &[(&str, &str, &str)] = &[
    ("400", "Malformed", "`malformed`: the request can't be understood; `field` says where"),
    ("403", "Forbidden", "`foreign_host`, `foreign_origin`: the request comes from where it must not"),
    ("404", "NotFound", "`not_found`: there is no such path, gripper or command"),
    ("408", "RequestTimeout", "`request_timeout`: the body did not arrive in time"),
    (
        "409",
        "Conflict",
        "`fast_stop`, `not_referenced`, `already_running`, `lease_held`, `stale_lease`, `stale_fast_stop`, \
         `fast_stop_unconfirmed`, `request_id_reused`, `name_taken`: not now; the members say what is in the way",
    ),
    ("413", "TooLarge", "`too_large`: the body is larger than `max` bytes"),
    (
        "422",
        "Unprocessable",
        "`out_of_range`: a value is beyond its limits, which `min` and `max` say; `device_refused`: the device \
         refused, and `device_status` says how",
    ),
    (
        "429",
        "Overloaded",
        "`overloaded`: too many requests wait for this gripper, too many WebSockets are open, or the device tag was \
         written less than a second ago",
    ),
    ("500", "Internal", "`internal`: a mistake of the gateway's own"),
    ("502", "DeviceProtocol", "`device_protocol`: the device's answer can't be one"),
    (
        "503",
        "LinkDown",
        "`link_down`: there is no working link to the device; `journal_down`: the journal takes no records, or can't \
         be read; `gateway_gone`: the gateway that owns the gripper is gone, and nothing was sent to it",
    ),
    (
        "504",
        "DeviceTimeout",
        "`device_timeout`: the device did not answer in time; `gateway_timeout`: the gateway that owns the gripper did \
         not, and whether it was done isn't known",
    ),
];

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
    /// Of what every operation can answer.
    AnyProblem ["400" "403" "500"];
    /// Of what reads the gateway's own knowledge of a gripper.
    GripperProblem ["400" "403" "404" "422" "500"];
    /// Of what asks a gripper's actor about its commands.
    CommandProblem ["400" "403" "404" "408" "413" "422" "429" "500" "503"];
    /// Of what asks for the lease.
    LeaseProblem ["400" "403" "404" "408" "409" "413" "422" "429" "500" "503"];
    /// Of what opens a WebSocket.
    SocketProblem ["400" "403" "429" "500"];
    /// Of what reads the journal.
    JournalProblem ["400" "403" "404" "422" "500" "503"];
    /// Of what asks the device.
    DeviceProblem ["400" "403" "404" "408" "409" "413" "422" "429" "500" "502" "503" "504"];
}

fn references(statuses: &[&str]) -> BTreeMap<String, RefOr<Response>> {
    PROBLEMS
        .iter()
        .filter(|(status, ..)| statuses.contains(status))
        .map(|(status, name, _)| ((*status).to_owned(), RefOr::Ref(Ref::from_response_name(*name))))
        .collect()
}

/// Adds the descriptions that the operations refer to.
pub fn describe(components: &mut Components) {
    let schema = Ref::from_schema_name(Members::name());
    for (_, name, description) in PROBLEMS {
        let content = ContentBuilder::new().schema(Some(schema.clone())).build();
        let response =
            ResponseBuilder::new().description(*description).content("application/problem+json", content).build();
        components.responses.insert((*name).to_owned(), response.into());
    }
}

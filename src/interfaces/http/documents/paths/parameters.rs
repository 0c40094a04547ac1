//! Parameters of operations outside the body, for the OpenAPI document.

use serde_json::{Value, json};
use utoipa::IntoParams;

use crate::model::Urgency;
use crate::operations::{DEFAULT_WAIT_MS, MAX_WAIT_MS, Operation};

/// Texts without control characters that clients may put into a header.
const HEADER_TEXT: &str = "^([!-~]([ -~]*[!-~])?)?$";
const NAME: &str = "^[a-z0-9][a-z0-9_-]{0,31}$";

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only described here")]
pub struct CommandPath {
    /// The command's id, as returned when the command was started.
    #[param(example = "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f")]
    command: uuid::Uuid,
}

/// Describes the parameters of an operation. `fields` is the schema of those that the path does not name.
pub fn of(operation: &Operation, fields: &Value) -> Vec<Value> {
    let mut parameters: Vec<_> = operation.path_parameters().map(in_path).collect();
    if !operation.changes_something() {
        parameters.extend(in_query(fields));
    }
    if operation.waits {
        parameters.push(wait(operation.starts_command));
    }
    if operation.is_of_gripper() && operation.urgency != Urgency::FastStop {
        if fields["properties"].get("request_id").is_some() {
            parameters.push(request_id());
        }
        parameters.push(lease());
    }
    if operation.is_conditional && operation.path_parameters().count() == 1 {
        parameters.extend(conditions());
    }
    parameters
}

/// Describes a parameter in the path.
pub fn in_path(name: &str) -> Value {
    let (description, example, schema) = match name {
        "gateway" => ("Name of the gateway that owns the gripper.", json!("gateway"), named()),
        "gripper" => ("The gripper's name.", json!("left"), named()),
        "webhook" => ("The webhook's name.", json!("mes"), named()),
        "command" => (
            "The command's id, as returned when the command was started.",
            json!("019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"),
            json!({"type": "string", "format": "uuid"}),
        ),
        "finger" => (
            "Number of the finger: 1 or 2.",
            json!(1),
            json!({"type": "integer", "format": "int32", "minimum": 1, "maximum": 2}),
        ),
        "part_id" => (
            "Id of the part: at most 48 bytes in UTF-8.",
            json!("A-1047"),
            json!({
                "type": "string", "minLength": 1, "maxLength": 48, "pattern": "^[^\\u0000-\\u001f\\u007f-\\u009f]+$",
            }),
        ),
        other => (other, Value::Null, json!({"type": "string"})),
    };
    json!({
        "name": name, "in": "path", "required": true, "description": description, "example": example, "schema": schema,
    })
}

fn named() -> Value {
    json!({"type": "string", "minLength": 1, "maxLength": 32, "pattern": NAME})
}

/// Describes the fields of a read, which HTTP has in the query string.
fn in_query(fields: &Value) -> Vec<Value> {
    let properties = fields["properties"].as_object().cloned().unwrap_or_default();
    let described = properties.into_iter().map(|(name, mut schema)| {
        let mut parameter = json!({"name": name, "in": "query", "required": false});
        // A parameter is absent instead of null.
        if let [kind, _] = schema["type"].as_array().map(Vec::as_slice).unwrap_or_default() {
            schema["type"] = kind.clone();
        }
        for text in ["description", "example"] {
            if let Some(text_of_schema) = schema.as_object_mut().and_then(|schema| schema.remove(text)) {
                parameter[text] = text_of_schema;
            }
        }
        parameter["schema"] = schema;
        parameter
    });
    described.collect()
}

/// Describes the wait for a command, which is long by default if the request starts it.
fn wait(starts_command: bool) -> Value {
    let (default, description) = if starts_command {
        let text = "Maximum time to wait for the command to end, in ms. 0 returns at once; the default is 5000.";
        (DEFAULT_WAIT_MS, text)
    } else {
        let text =
            "Maximum time to wait for the command to end, in ms. The default is 0: the command is returned at once.";
        (0, text)
    };
    json!({
        "name": "wait_ms", "in": "query", "required": false, "description": description, "example": DEFAULT_WAIT_MS,
        "schema": {"type": "integer", "format": "int64", "minimum": 0, "maximum": MAX_WAIT_MS, "default": default},
    })
}

fn request_id() -> Value {
    let description = "Same as `request_id` in the body, for clients that send it as a header.";
    header("Idempotency-Key", description, HEADER_TEXT)
}

fn lease() -> Value {
    let description =
        "The lease token, if the client holds the lease. The lease does not expire while the request is open.";
    header("Wsg-Lease", description, HEADER_TEXT)
}

/// Describes the headers with the version that a request expects.
fn conditions() -> [Value; 2] {
    let if_match = "Version that the recipe must have, as in its `ETag`, or `*` for any; otherwise the request fails with \
                    412. The mark of a proxy that has compressed the response (`W/\"1\"`, `\"1-gzip\"`) makes no \
                    difference.";
    let if_none_match = "`*` if there must be no recipe yet; otherwise the request fails with 412.";
    let pattern = "^(\\*|(W/)?\"[0-9]{1,16}(-gzip|-br|-zstd|-deflate)?\")$";
    let mut conditions = [header("If-Match", if_match, pattern), header("If-None-Match", if_none_match, "^\\*$")];
    for condition in &mut conditions {
        condition["schema"]["minLength"] = 1.into();
    }
    conditions
}

fn header(name: &str, description: &str, pattern: &str) -> Value {
    json!({
        "name": name, "in": "header", "required": false, "description": description,
        "schema": {"type": "string", "maxLength": 64, "pattern": pattern},
    })
}

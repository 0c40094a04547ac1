use super::*;
use crate::model::Link;

fn members(rejection: impl Into<Rejection>) -> (u16, Value) {
    let problem = Problem::from(rejection.into());
    (problem.status().as_u16(), serde_json::to_value(problem.members()).unwrap())
}

#[test]
fn value_out_of_range_names_its_limits() {
    let (field, limit) = ("width_mm", "the device's stroke");
    let (status, problem) = members(Invalid::OutOfRange { field, value: 96.3, min: 0.0, max: 68.1, limit });
    assert_eq!(status, 422);
    let expected = serde_json::json!({
        "type": "about:blank", "title": "Unprocessable Entity", "status": 422, "code": "out_of_range", "code_number": 18,
        "detail": "width_mm is 96.3; it must be from 0 to 68.1 (the device's stroke)",
        "field": "width_mm", "value": 96.3, "min": 0.0, "max": 68.1
    });
    assert_eq!(problem, expected);
}

#[test]
fn conflict_names_its_cause() {
    let id = FastStopId::generate();
    let (status, problem) = members(Conflict::FastStop { id });
    assert_eq!(
        (status, &problem["code"], &problem["fast_stop_id"]),
        (409, &"fast_stop".into(), &id.to_string().into())
    );
    let id = CommandId::generate();
    let (status, problem) = members(Conflict::AlreadyRunning { id });
    assert_eq!(
        (status, &problem["code"], &problem["command_id"]),
        (409, &"already_running".into(), &id.to_string().into())
    );
}

#[test]
fn device_refusal_is_not_our_error() {
    let refused = |status, fast_stop| {
        let (http, problem) = members(DeviceRefusal { command: "Grip", status, fast_stop });
        let code = problem["code"].as_str().unwrap().to_owned();
        (http, code, problem["device_status"].as_str().unwrap().to_owned(), problem["device_status_code"].clone())
    };
    let expect = |http, code: &str, name: &str, number: u16| (http, code.to_owned(), name.to_owned(), number.into());
    let latch = Some(FastStopId::generate());
    assert_eq!(refused(Status::E_ACCESS_DENIED, latch), expect(409, "fast_stop", "E_ACCESS_DENIED", 16));
    assert_eq!(refused(Status::E_ACCESS_DENIED, None), expect(422, "device_refused", "E_ACCESS_DENIED", 16));
    assert_eq!(refused(Status::E_NOT_INITIALIZED, None), expect(409, "not_referenced", "E_NOT_INITIALIZED", 3));
    assert_eq!(refused(Status::E_ALREADY_RUNNING, None), expect(409, "release_first", "E_ALREADY_RUNNING", 4));
    assert_eq!(refused(Status::E_RANGE_ERROR, None), expect(422, "out_of_range", "E_RANGE_ERROR", 28));
    assert_eq!(refused(Status::E_CMD_FAILED, None), expect(422, "device_refused", "E_CMD_FAILED", 18));
    assert_eq!(refused(Status::from_code(4711), None), expect(422, "device_refused", "E_4711", 4711));
}

#[test]
fn failure_has_status_and_code() {
    let code = |failure: Failure| {
        let (status, problem) = members(failure);
        (status, problem["code"].as_str().unwrap().to_owned())
    };
    let (url, cause) = ("tcp://192.168.1.20:1000".to_owned(), Some("no route to host".to_owned()));
    assert_eq!(code(Failure::LinkDown { link: Link::Reconnecting, url, cause }), (503, "link_down".to_owned()));
    assert_eq!(code(Failure::Draining), (503, "link_down".to_owned()));
    assert_eq!(code(Failure::DeviceTimeout { command: "Loop", waited_ms: 500 }), (504, "device_timeout".to_owned()));
    let detail = String::new();
    assert_eq!(code(Failure::DeviceProtocol { command: "Loop", detail }), (502, "device_protocol".to_owned()));
    assert_eq!(code(Failure::Overloaded { limit: 64 }), (429, "overloaded".to_owned()));
    let line_time = Failure::LineTime { command: "Loop", line_ms: 250, max_ms: 100 };
    assert_eq!(code(line_time), (409, "already_running".to_owned()));
}

#[test]
fn long_texts_of_a_client_are_cut() {
    let long = "\u{fc}".repeat(60_000);
    let problem = Problem::malformed(&*long, &*long);
    assert_eq!(problem.detail().len(), MAX_DETAIL_BYTES);
    assert_eq!(problem.members().field().map(str::len), Some(MAX_FIELD_BYTES));
}

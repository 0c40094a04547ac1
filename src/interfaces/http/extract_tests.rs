use axum::http::Request;

use super::*;

fn context() -> Arc<Context> {
    Arc::new(Context::of([]))
}

fn parts(uri: &str, headers: &[(&str, &str)]) -> Parts {
    let mut request = Request::get(uri);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.body(()).unwrap().into_parts().0
}

async fn wait_ms(uri: &str) -> Result<Duration, u16> {
    let mut parts = parts(uri, &[]);
    let wait = WaitMs::<5000>::from_request_parts(&mut parts, &context()).await;
    wait.map(|wait| wait.limit).map_err(|problem| problem.status().as_u16())
}

#[tokio::test]
async fn a_wait_is_from_0_to_60000_ms() {
    assert_eq!(wait_ms("/home").await, Ok(Duration::from_secs(5)));
    assert_eq!(wait_ms("/home?wait_ms=0").await, Ok(Duration::ZERO));
    assert_eq!(wait_ms("/home?wait_ms=96.0&other=1").await, Ok(Duration::from_millis(96)));
    assert_eq!(wait_ms("/home?wait_ms=60000").await, Ok(Duration::from_mins(1)));
    for beyond in ["60001", "-1", "1e30"] {
        assert_eq!(wait_ms(&format!("/home?wait_ms={beyond}")).await, Err(422), "{beyond}");
    }
    for wrong in ["abc", "", "0.5", "NaN", "inf", "1&wait_ms=2"] {
        assert_eq!(wait_ms(&format!("/home?wait_ms={wrong}")).await, Err(400), "{wrong}");
    }
}

#[tokio::test]
async fn keys_come_from_the_headers_or_the_body() {
    let mut parts = parts("/home", &[("Idempotency-Key", "job 7"), ("Wsg-Lease", "token")]);
    let headers = Keys::from_request_parts(&mut parts, &context()).await.unwrap();
    let body = Keys::default().or_body(Some("job 7"), Some("token")).unwrap();
    assert_eq!(headers, body);
    assert_eq!(headers.clone().or_body(Some("job 7"), None).unwrap(), body);
    assert_eq!(headers.or_body(Some("job 8"), None).unwrap_err().status().as_u16(), 400);
}

#[tokio::test]
async fn an_empty_key_is_none() {
    let mut parts = parts("/home", &[("Idempotency-Key", ""), ("Wsg-Lease", "")]);
    let headers = Keys::from_request_parts(&mut parts, &context()).await.unwrap();
    assert_eq!(headers.or_body(Some(""), Some("")).unwrap(), Keys::default());
}

#[tokio::test]
async fn a_key_that_is_no_text_is_refused() {
    let refused = async |headers: &[(&str, &str)]| {
        let mut parts = parts("/home", headers);
        Keys::from_request_parts(&mut parts, &context()).await.unwrap_err().status().as_u16()
    };
    assert_eq!(refused(&[("Idempotency-Key", &"x".repeat(65))]).await, 422);
    assert_eq!(refused(&[("Idempotency-Key", "a\tb")]).await, 400);
    assert_eq!(refused(&[("Idempotency-Key", "a"), ("Idempotency-Key", "b")]).await, 400);
    assert_eq!(Keys::default().or_body(Some("a\nb"), None).unwrap_err().status().as_u16(), 400);
}

#[test]
fn a_client_is_known_by_its_address() {
    let mut parts = parts("/", &[]);
    parts.extensions.insert(ConnectInfo("[::ffff:10.0.0.7]:5000".parse::<SocketAddr>().unwrap()));
    assert_eq!(&*Asker::of(&parts.extensions).0.subject, "http:10.0.0.7");
}

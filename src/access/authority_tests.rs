use std::fs;
use std::path::PathBuf;

use jiff::ToSpan as _;

use super::super::{ClientCertificate, ClientMatch, NewToken, Scope};
use super::*;

struct Tried {
    directory: PathBuf,
    file: TokenFile,
    access: Access,
}

impl Drop for Tried {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.directory).unwrap();
    }
}

fn tried(name: &str) -> Tried {
    let directory = std::env::temp_dir().join(format!("wsg-access-{}-{name}", std::process::id()));
    fs::create_dir_all(&directory).unwrap();
    let file = TokenFile::at(directory.join("tokens.json"));
    let plc = KnownClient {
        name: "plc".parse().unwrap(),
        matched_by: ClientMatch::Address("192.168.1.10/32".parse().unwrap()),
        role: Role::Operator,
        scope: Scope::Only(["left".parse().unwrap()].into()),
    };
    let mes =
        KnownClient { matched_by: ClientMatch::Certificate("mes".to_owned()), role: Role::Observer, ..plc.clone() };
    let times = SessionTimes { idle: Duration::from_mins(10), pin_idle: Duration::from_mins(5) };
    let guard = Guard::new(file.clone(), vec![plc, mes], (FastStopPolicy::Credential, None), times).unwrap();
    Tried { directory, file, access: Access::new(AccessRules::Guarded(Box::new(guard))) }
}

fn create(tried: &Tried, name: &str, role: Role, expires_at: Option<Timestamp>) -> Credential {
    let new = NewToken { name: name.parse().unwrap(), role, grippers: None, expires_at };
    Credential::Token(tried.file.create(Timestamp::now(), new).unwrap())
}

#[test]
fn token_is_valid_from_its_creation_to_its_revocation() {
    let tried = tried("life");
    let token = create(&tried, "mes", Role::Observer, None);
    let identity = tried.access.identify(&token, &ClientOrigin::default()).unwrap();
    assert_eq!((identity.name.unwrap().as_str(), identity.role, identity.proof), ("mes", Role::Observer, Proof::Token));
    tried.file.revoke(&"mes".parse().unwrap()).unwrap();
    assert_eq!(tried.access.identify(&token, &ClientOrigin::default()), Err(Unauthorized::Unknown));
}

#[test]
fn expired_token_is_refused() {
    let tried = tried("expired");
    let token = create(&tried, "mes", Role::Observer, Some(Timestamp::now() - 1.second()));
    assert_eq!(tried.access.identify(&token, &ClientOrigin::default()), Err(Unauthorized::Expired));
}

fn holder(name: &str, seconds: i64) -> ClientCertificate {
    ClientCertificate { common_name: name.into(), expires_at: Timestamp::now() + seconds.seconds() }
}

#[test]
fn address_identifies_a_client_without_a_credential_only() {
    let tried = tried("address");
    let at = |address: &str| ClientOrigin::from(address.parse::<std::net::IpAddr>().unwrap());
    let peer = &at("::ffff:192.168.1.10");
    let plc = tried.access.identify(&Credential::None, peer).unwrap();
    assert!(plc.may(Right::Operate, Some(&"left".parse().unwrap())) && !plc.may(Right::Operate, None));
    let stranger = TokenSecret::generate().unwrap();
    assert_eq!(tried.access.identify(&Credential::Token(stranger), peer), Err(Unauthorized::Unknown));
    assert_eq!(tried.access.identify(&Credential::Malformed, peer), Err(Unauthorized::Malformed));
    let cut = tried.access.identify(&Credential::of_token("wsg_wrong"), peer).unwrap_err();
    assert!(cut.to_string().contains("47 characters and begin with wsg_: copy it again"), "{cut}");
    assert_eq!(tried.access.identify(&Credential::None, &at("192.168.1.11")), Err(Unauthorized::Missing));
    // A certificate decides before the address.
    let mes = ClientOrigin { certificate: Some(holder("mes", 60)), ..peer.clone() };
    let mes = tried.access.identify(&Credential::None, &mes).unwrap();
    assert_eq!((mes.role, mes.proof), (Role::Observer, Proof::Certificate));
    let expired = ClientOrigin { certificate: Some(holder("mes", -1)), address: None };
    assert_eq!(tried.access.identify(&Credential::None, &expired), Err(Unauthorized::Missing));
    let unknown = ClientOrigin { certificate: Some(holder("plc", 60)), address: None };
    assert_eq!(tried.access.identify(&Credential::None, &unknown), Err(Unauthorized::Missing));
}

#[test]
fn pin_adds_a_persons_rights_to_a_session() {
    let tried = tried("pin");
    let Credential::Token(secret) = create(&tried, "panel", Role::Observer, None) else { panic!("not a token") };
    let (id, _) = tried.access.sign_in(&secret).unwrap().unwrap();
    let new = NewToken { name: "anna".parse().unwrap(), role: Role::Operator, grippers: None, expires_at: None };
    let pin = tried.file.create_pin(Timestamp::now(), new).unwrap();
    let session = Credential::Session(id.clone());
    let now =
        || tried.access.identify(&session, &ClientOrigin::default()).map(|identity| identity.name.unwrap().to_string());
    let stranger = SessionId::parse(&"x".repeat(43)).unwrap();
    assert_eq!(tried.access.enter_pin(&stranger, &pin), Err(Unauthorized::SessionEnded));
    let wrong = if pin.expose() == "000000" { "000001" } else { "000000" };
    assert_eq!(tried.access.enter_pin(&id, &wrong.parse().unwrap()), Err(Unauthorized::WrongPin));
    assert_eq!(tried.access.enter_pin(&id, &pin).unwrap().role, Role::Operator);
    assert_eq!(now(), Ok("anna".to_owned()));
    tried.access.forget_pin(&id);
    assert_eq!(now(), Ok("panel".to_owned()));
    tried.access.enter_pin(&id, &pin).unwrap();
    tried.file.revoke(&"anna".parse().unwrap()).unwrap();
    assert_eq!(now(), Ok("panel".to_owned()), "a revoked PIN ends at once");
    assert_eq!(tried.access.enter_pin(&id, &pin), Err(Unauthorized::WrongPin));
    tried.file.revoke(&"panel".parse().unwrap()).unwrap();
    assert_eq!(now(), Err(Unauthorized::SessionEnded));
}

#[test]
fn sessions_outlive_new_rules() {
    let tried = tried("rules");
    let Credential::Token(secret) = create(&tried, "anna", Role::Operator, None) else { panic!("not a token") };
    let (id, _) = tried.access.sign_in(&secret).unwrap().unwrap();
    let times = SessionTimes { idle: Duration::from_mins(1), pin_idle: Duration::from_mins(1) };
    let guard = Guard::new(tried.file.clone(), Vec::new(), (FastStopPolicy::Anyone, None), times).unwrap();
    assert!(!tried.access.lets_anyone_stop());
    tried.access.replace(AccessRules::Guarded(Box::new(guard)));
    assert!(tried.access.lets_anyone_stop());
    assert!(tried.access.identify(&Credential::Session(id), &ClientOrigin::default()).is_ok());
}

#[test]
fn session_ends_with_its_token() {
    let tried = tried("session");
    let Credential::Token(secret) = create(&tried, "anna", Role::Operator, None) else { panic!("not a token") };
    let (id, identity) = tried.access.sign_in(&secret).unwrap().unwrap();
    let session = Credential::Session(id.clone());
    let found = tried.access.identify(&session, &ClientOrigin::default());
    assert_eq!(found, Ok(Identity { session: Some(id.clone()), ..identity }));
    tried.file.revoke(&"anna".parse().unwrap()).unwrap();
    assert_eq!(tried.access.identify(&session, &ClientOrigin::default()), Err(Unauthorized::SessionEnded));
    assert!(tried.access.sign_in(&secret).is_err());
    tried.access.sign_out(&id);
    assert_eq!(tried.access.identify(&session, &ClientOrigin::default()), Err(Unauthorized::SessionEnded));
}

#[test]
fn unreadable_file_keeps_the_known_tokens() {
    let tried = tried("unreadable");
    let token = create(&tried, "mes", Role::Observer, None);
    tried.access.identify(&token, &ClientOrigin::default()).unwrap();
    fs::write(tried.file.path(), "{").unwrap();
    assert!(tried.access.identify(&token, &ClientOrigin::default()).is_ok());
    fs::remove_file(tried.file.path()).unwrap();
    assert_eq!(tried.access.identify(&token, &ClientOrigin::default()), Err(Unauthorized::Unknown));
}

#[test]
fn open_gateway_lets_anyone_do_everything() {
    let anyone = Access::default().identify(&Credential::None, &ClientOrigin::default()).unwrap();
    assert!(anyone.may(Right::Supervise, None) && Access::default().lets_anyone_stop());
}

use std::fs;
use std::path::PathBuf;

use jiff::ToSpan as _;

use super::super::{NewToken, Right};
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
    let plc = AddressClient {
        name: "plc".parse().unwrap(),
        network: "192.168.1.10/32".parse().unwrap(),
        role: Role::Operator,
        scope: Scope::Only(["left".parse().unwrap()].into()),
    };
    let guard =
        Guard::new(file.clone(), vec![plc], (FastStopPolicy::Credential, None), Duration::from_mins(10)).unwrap();
    Tried { directory, file, access: Access::Guarded(Box::new(guard)) }
}

fn create(tried: &Tried, name: &str, role: Role, expires_at: Option<Timestamp>) -> Credential {
    let new = NewToken { name: name.parse().unwrap(), role, grippers: None, expires_at };
    Credential::Token(tried.file.create(Timestamp::now(), new).unwrap())
}

#[test]
fn token_is_valid_from_its_creation_to_its_revocation() {
    let tried = tried("life");
    let token = create(&tried, "mes", Role::Observer, None);
    let identity = tried.access.identify(&token, None).unwrap();
    assert_eq!((identity.name.unwrap().as_str(), identity.role, identity.proof), ("mes", Role::Observer, Proof::Token));
    tried.file.revoke(&"mes".parse().unwrap()).unwrap();
    assert_eq!(tried.access.identify(&token, None), Err(Unauthorized::Unknown));
}

#[test]
fn expired_token_is_refused() {
    let tried = tried("expired");
    let token = create(&tried, "mes", Role::Observer, Some(Timestamp::now() - 1.second()));
    assert_eq!(tried.access.identify(&token, None), Err(Unauthorized::Expired));
}

#[test]
fn address_identifies_a_client_without_a_credential_only() {
    let tried = tried("address");
    let peer = Some("::ffff:192.168.1.10".parse().unwrap());
    let plc = tried.access.identify(&Credential::None, peer).unwrap();
    assert!(plc.may(Right::Operate, Some(&"left".parse().unwrap())) && !plc.may(Right::Operate, None));
    let stranger = TokenSecret::generate().unwrap();
    assert_eq!(tried.access.identify(&Credential::Token(stranger), peer), Err(Unauthorized::Unknown));
    assert_eq!(tried.access.identify(&Credential::Malformed, peer), Err(Unauthorized::Malformed));
    let other = Some("192.168.1.11".parse().unwrap());
    assert_eq!(tried.access.identify(&Credential::None, other), Err(Unauthorized::Missing));
}

#[test]
fn session_ends_with_its_token() {
    let tried = tried("session");
    let Credential::Token(secret) = create(&tried, "anna", Role::Operator, None) else { panic!("not a token") };
    let (id, identity) = tried.access.sign_in(&secret).unwrap().unwrap();
    let session = Credential::Session(id.clone());
    assert_eq!(tried.access.identify(&session, None), Ok(identity));
    tried.file.revoke(&"anna".parse().unwrap()).unwrap();
    assert_eq!(tried.access.identify(&session, None), Err(Unauthorized::SessionEnded));
    assert!(tried.access.sign_in(&secret).is_err());
    tried.access.sign_out(&id);
    assert_eq!(tried.access.identify(&session, None), Err(Unauthorized::SessionEnded));
}

#[test]
fn unreadable_file_keeps_the_known_tokens() {
    let tried = tried("unreadable");
    let token = create(&tried, "mes", Role::Observer, None);
    tried.access.identify(&token, None).unwrap();
    fs::write(tried.file.path(), "{").unwrap();
    assert!(tried.access.identify(&token, None).is_ok());
    fs::remove_file(tried.file.path()).unwrap();
    assert_eq!(tried.access.identify(&token, None), Err(Unauthorized::Unknown));
}

#[test]
fn open_gateway_lets_anyone_do_everything() {
    let anyone = Access::Open.identify(&Credential::None, None).unwrap();
    assert!(anyone.may(Right::Supervise, None) && Access::Open.lets_anyone_stop());
}

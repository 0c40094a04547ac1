use std::os::unix::fs::PermissionsExt as _;

use super::*;

fn file(name: &str) -> (PathBuf, TokenFile) {
    let directory = std::env::temp_dir().join(format!("wsg-tokens-{}-{name}", std::process::id()));
    (directory.clone(), TokenFile::at(directory.join("tokens.json")))
}

fn new(name: &str) -> NewToken {
    NewToken { name: name.parse().unwrap(), role: Role::Operator, grippers: None, expires_at: None }
}

#[test]
fn file_has_no_secret_and_belongs_to_its_owner() {
    let (directory, file) = file("owner");
    let secret = file.create(Timestamp::now(), new("plc7")).unwrap();
    let text = fs::read_to_string(file.path()).unwrap();
    assert!(!text.contains(secret.expose()) && text.contains("plc7"), "{text}");
    assert_eq!(fs::metadata(file.path()).unwrap().mode() & 0o777, MODE);
    fs::set_permissions(file.path(), fs::Permissions::from_mode(0o640)).unwrap();
    assert!(file.list().unwrap_err().to_string().contains("chmod 600"));
    fs::remove_dir_all(directory).unwrap();
}

#[test]
fn names_are_unique_until_revoked() {
    let (directory, file) = file("unique");
    assert_eq!(file.list().unwrap(), []);
    file.create(Timestamp::now(), new("plc7")).unwrap();
    assert!(matches!(file.create(Timestamp::now(), new("plc7")), Err(TokenFileError::Exists(_))));
    let name = "plc7".parse().unwrap();
    file.revoke(&name).unwrap();
    assert!(matches!(file.revoke(&name), Err(TokenFileError::NotFound(_))));
    file.create(Timestamp::now(), new("plc7")).unwrap();
    assert_eq!(file.list().unwrap().len(), 1);
    fs::remove_dir_all(directory).unwrap();
}

#[test]
fn byte_order_mark_is_ignored() {
    let (directory, file) = file("mark");
    file.create(Timestamp::now(), new("plc7")).unwrap();
    let text = fs::read_to_string(file.path()).unwrap();
    fs::write(file.path(), format!("\u{FEFF}{text}")).unwrap();
    assert_eq!(file.list().unwrap().len(), 1);
    fs::remove_dir_all(directory).unwrap();
}

#[test]
fn simultaneous_changes_lose_nothing() {
    let (directory, file) = file("simultaneous");
    std::thread::scope(|scope| {
        for number in 0..16 {
            let file = &file;
            scope.spawn(move || file.create(Timestamp::now(), new(&format!("plc{number}"))).unwrap());
        }
    });
    assert_eq!(file.list().unwrap().len(), 16);
    fs::remove_dir_all(directory).unwrap();
}

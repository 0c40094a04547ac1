//! Permissions of serial ports.

use std::fs;
use std::os::unix::fs::MetadataExt as _;

use super::Diagnosis;
use crate::transport::SerialAddress;

/// User of the service (`deploy/systemd`).
const SERVICE_USER: &str = "wsg-gateway";

/// A user and its groups.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Account {
    pub(super) name: String,
    id: u32,
    groups: Vec<u32>,
}

impl Account {
    /// The user that runs the gateway: the service's if this is root, or else this program's.
    fn of_gateway() -> Self {
        let own = rustix::process::geteuid();
        let service = Self::of_service().filter(|_| own.is_root());
        service.unwrap_or_else(|| {
            let main = rustix::process::getegid();
            let groups = rustix::process::getgroups().unwrap_or_default().into_iter().chain([main]);
            let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
            let id = own.as_raw();
            let name = name_of(&users, id).unwrap_or_else(|| id.to_string());
            Self { name, id, groups: groups.map(rustix::process::Gid::as_raw).collect() }
        })
    }

    /// The service's user, if it exists.
    pub(super) fn of_service() -> Option<Self> {
        let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
        let groups = fs::read_to_string("/etc/group").unwrap_or_default();
        Self::named(SERVICE_USER, &users, &groups)
    }

    /// Looks a user up in the texts of passwd(5) and group(5).
    fn named(name: &str, users: &str, groups: &str) -> Option<Self> {
        let user = users.lines().map(fields).find(|user| user[0] == name)?;
        let others = groups.lines().map(fields).filter(|group| has_member(group, name));
        let others = others.filter_map(|group| group.get(2)?.parse().ok());
        let main = user.get(3)?.parse().ok()?;
        Some(Self { name: name.to_owned(), id: user.get(2)?.parse().ok()?, groups: others.chain([main]).collect() })
    }

    /// Whether the user can read and write a file.
    fn can_use(&self, mode: u32, owner: u32, group: u32) -> bool {
        let bits = if self.id == owner {
            mode >> 6
        } else if self.groups.contains(&group) {
            mode >> 3
        } else {
            mode
        };
        self.id == 0 || bits & 0o6 == 0o6
    }
}

fn fields(line: &str) -> Vec<&str> {
    line.split(':').collect()
}

/// Whether a line of group(5) lists the user.
fn has_member(group: &[&str], user: &str) -> bool {
    group.get(3).is_some_and(|members| members.split(',').any(|member| member == user))
}

/// Returns a problem if the gateway's user cannot open the port. A missing port is found when it is opened.
pub(super) fn check(address: &SerialAddress) -> Option<Diagnosis> {
    let port = fs::metadata(&address.path).ok()?;
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    judge(&address.path, &Account::of_gateway(), [port.mode(), port.uid(), port.gid()], &groups)
}

fn judge(path: &str, account: &Account, [mode, owner, group]: [u32; 3], groups: &str) -> Option<Diagnosis> {
    if account.can_use(mode, owner, group) {
        return None;
    }
    let user = &account.name;
    let group_name = name_of(groups, group).unwrap_or_else(|| group.to_string());
    let remedy = if mode & 0o060 == 0o060 && group != 0 {
        format!("run `sudo usermod -aG {group_name} {user}`, and restart the gateway")
    } else {
        format!("let a udev rule give the port to the group dialout with mode 0660; now it has {:04o}", mode & 0o777)
    };
    let text = format!("{user} cannot open {path}, which belongs to the group {group_name}: {remedy}");
    Some(Diagnosis::problem("serial port", text))
}

/// Returns the name with an id in the text of passwd(5) or group(5).
fn name_of(entries: &str, id: u32) -> Option<String> {
    let fields = entries.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let found = fields.into_iter().find(|fields| fields.get(2).is_some_and(|field| *field == id.to_string()))?;
    Some(found[0].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const USERS: &str = "root:x:0:0:root:/root:/bin/sh\nwsg-gateway:x:998:998::/var/lib/wsg-gateway:/bin/false\n";

    #[test]
    fn user_outside_the_ports_group_is_a_problem() {
        let groups = |members: &str| format!("root:x:0:\ndialout:x:20:{members}\nwsg-gateway:x:998:\n");
        let finding = |members: &str, mode| {
            let account = Account::named("wsg-gateway", USERS, &groups(members)).unwrap();
            judge("/dev/ttyUSB0", &account, [mode, 0, 20], &groups(members)).map(|finding| finding.text)
        };
        assert_eq!(finding("operator,wsg-gateway", 0o020_660), None);
        assert_eq!(finding("", 0o020_666), None);
        let wrong = finding("operator", 0o020_660).unwrap();
        assert!(wrong.starts_with("wsg-gateway cannot open /dev/ttyUSB0"), "{wrong}");
        assert!(wrong.contains("sudo usermod -aG dialout wsg-gateway"), "{wrong}");
        assert!(finding("wsg-gateway", 0o020_600).unwrap().contains("udev rule"));
        assert_eq!(Account::named("nobody", USERS, ""), None);
    }
}

//! `wsg-gateway backup` and `restore`: everything that a gateway needs, as one tar archive.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _, fchown};
use std::path::{Component, Path, PathBuf};

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tar::{Archive, Builder, EntryType, Header};

use crate::config::{AccessConfig, Config, Flags, JournalLocation, named_files};
use crate::journal::{back_up, is_in_use};

/// Entry that describes the archive; the first one.
const MANIFEST: &str = "wsg-gateway-backup.json";

/// Version of the archive's format.
const FORMAT: u32 = 1;

/// Greatest size of a file besides the journal, in bytes.
const MAX_FILE_BYTES: u64 = 16 << 20;

#[derive(Debug, Args)]
pub(super) struct BackupArgs {
    /// New file for the backup
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    flags: Flags,
}

#[derive(Debug, Args)]
pub(super) struct RestoreArgs {
    /// Backup to restore
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Directory below which all files are written, in place of their own directories
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Manifest {
    format: u32,
    gateway: String,
    version: String,
    at: Timestamp,
}

/// Files of a backup, and files that the configuration names but that do not exist.
#[derive(Debug, Default)]
struct Saved {
    files: Vec<PathBuf>,
    missing: Vec<PathBuf>,
}

/// Writes the configuration, the files that it names, and a copy of the journal. A running gateway is not disturbed.
pub(super) fn back_up_all(args: &BackupArgs, mut out: impl Write) -> anyhow::Result<()> {
    let config = Config::load(&args.flags)?;
    let to = &args.file;
    ensure!(!to.exists(), "{} exists: name a new file", to.display());
    let part = with_ending(to, ".part");
    let written = write_archive(&part, args, &config).and_then(|saved| {
        fs::rename(&part, to).with_context(|| to.display().to_string())?;
        Ok(saved)
    });
    let Saved { files, missing } = match written {
        Ok(saved) => saved,
        Err(error) => {
            let _ = fs::remove_file(&part);
            return Err(error);
        }
    };
    for file in &files {
        writeln!(out, "saved {}", file.display())?;
    }
    for file in &missing {
        writeln!(out, "left out {}: it does not exist", file.display())?;
    }
    if let JournalLocation::File(journal) = &config.journal.place
        && is_in_use(journal) != Some(true)
    {
        let journal = journal.display();
        writeln!(out, "no gateway uses {journal} now; if yours runs with --journal or --config, name that here too")?;
    }
    let to = to.display();
    writeln!(out, "{to}: {} files; restore them with `wsg-gateway restore {to}`", files.len())?;
    Ok(())
}

fn write_archive(part: &Path, args: &BackupArgs, config: &Config) -> anyhow::Result<Saved> {
    // The mode counts only for a new file. A leftover of an interrupted backup could have another.
    match fs::remove_file(part) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error).context(part.display().to_string()),
        _ => {}
    }
    let created = OpenOptions::new().write(true).create_new(true).mode(0o600).open(part);
    let mut archive = Builder::new(created.with_context(|| part.display().to_string())?);
    let manifest = Manifest {
        format: FORMAT,
        gateway: config.name.to_string(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        at: Timestamp::now(),
    };
    let manifest = serde_json::to_vec_pretty(&manifest)?;
    append(&mut archive, Path::new(MANIFEST), (0o600, 0), manifest.len() as u64, manifest.as_slice())?;
    let mut saved = Saved::default();
    for path in files_of(args, config)? {
        let absolute = plain(&path)?;
        if saved.files.contains(&absolute) || saved.missing.contains(&absolute) {
            continue;
        }
        let file = match File::open(&absolute) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                saved.missing.push(absolute);
                continue;
            }
            Err(error) => return Err(error).with_context(|| absolute.display().to_string()),
        };
        let metadata = file.metadata()?;
        ensure!(metadata.len() <= MAX_FILE_BYTES, "{} is larger than 16 MiB: not a gateway's file", absolute.display());
        let owner = (metadata.mode() & 0o777, metadata.uid());
        append(&mut archive, &absolute, owner, metadata.len(), file.take(metadata.len()))?;
        saved.files.push(absolute);
    }
    if let JournalLocation::File(journal) = &config.journal.place {
        let journal = plain(journal)?;
        let copy = with_ending(part, "-journal");
        let appended = back_up(&journal, &copy, |_, _| {}).map_err(Into::into).and_then(|()| {
            let file = File::open(&copy)?;
            append(&mut archive, &journal, (0o600, 0), file.metadata()?.len(), file)
        });
        let _ = fs::remove_file(&copy);
        appended?;
        saved.files.push(journal);
    }
    archive.into_inner()?.sync_all()?;
    Ok(saved)
}

/// Returns the files besides the journal. Some can be named twice.
fn files_of(args: &BackupArgs, config: &Config) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = match &args.flags.config {
        Some(config) => named_files(config)?,
        None => Vec::new(),
    };
    if let AccessConfig::Guarded(guarded) = &config.access {
        files.push(guarded.tokens.clone());
    }
    Ok(files)
}

/// Returns an absolute path without `..`, which an archive cannot have.
fn plain(path: &Path) -> io::Result<PathBuf> {
    let absolute = std::path::absolute(path)?;
    let is_plain = !absolute.components().any(|component| component == Component::ParentDir);
    let (Some(directory), Some(name), false) = (absolute.parent(), absolute.file_name(), is_plain) else {
        return Ok(absolute);
    };
    match directory.canonicalize() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(absolute),
        directory => Ok(directory?.join(name)),
    }
}

/// Appends a file with its mode and the id of its owner.
fn append(
    archive: &mut Builder<File>,
    path: &Path,
    (mode, owner): (u32, u32),
    bytes: u64,
    content: impl Read,
) -> anyhow::Result<()> {
    let mut header = Header::new_gnu();
    header.set_entry_type(EntryType::Regular);
    header.set_mode(mode);
    header.set_uid(owner.into());
    header.set_size(bytes);
    let inside = path.strip_prefix("/").unwrap_or(path);
    archive.append_data(&mut header, inside, content).with_context(|| path.display().to_string())
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(ending);
    path.into()
}

/// Writes the files of a backup to their places. No file is replaced.
pub(super) fn restore(args: &RestoreArgs, mut out: impl Write) -> anyhow::Result<()> {
    let root = args.root.as_deref().unwrap_or(Path::new("/"));
    let manifest = read_manifest(&args.file)?;
    let mut targets = Vec::new();
    each_file(&args.file, |path, _| {
        targets.push(target(root, path)?);
        Ok(())
    })?;
    for (index, target) in targets.iter().enumerate() {
        ensure!(
            !targets[..index].contains(target),
            "{} is twice in the backup: nothing was restored",
            target.display()
        );
        // A write-ahead log of another journal would damage the restored one.
        for taken in [target.clone(), with_ending(target, "-wal"), with_ending(target, "-shm")] {
            ensure!(
                !taken.exists(),
                "{} exists, so nothing was restored: move it away, or restore below --root DIR",
                taken.display()
            );
        }
    }
    each_file(&args.file, |path, entry| {
        let target = target(root, path)?;
        write_file(&target, entry).with_context(|| target.display().to_string())?;
        writeln!(out, "restored {}", target.display())?;
        Ok(())
    })?;
    let Manifest { gateway, at, .. } = manifest;
    writeln!(
        out,
        "gateway {gateway} as of {at:.0}: start it, look at each gripper, then acknowledge the alarm \
         `journal_restored`; until then, for at most 10 minutes, requests with an unknown id are refused"
    )?;
    Ok(())
}

fn read_manifest(archive: &Path) -> anyhow::Result<Manifest> {
    let file = File::open(archive).with_context(|| archive.display().to_string())?;
    let no_backup = format!("{} is not a backup of a gateway", archive.display());
    let mut archive = Archive::new(file);
    let first = archive.entries()?.next().transpose().ok().flatten();
    let first = first.filter(|first| first.path().is_ok_and(|path| path == Path::new(MANIFEST)));
    let Some(first) = first else { bail!(no_backup) };
    let manifest: Manifest = serde_json::from_reader(first.take(MAX_FILE_BYTES)).context(no_backup)?;
    ensure!(
        manifest.format == FORMAT,
        "the backup has format {}, but this gateway reads format {FORMAT}: use version {} of it",
        manifest.format,
        manifest.version
    );
    Ok(manifest)
}

/// Calls `each` for each file besides the manifest, with its path in the archive.
fn each_file(
    archive: &Path,
    mut each: impl FnMut(&Path, &mut tar::Entry<'_, File>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut archive = Archive::new(File::open(archive)?);
    for entry in archive.entries()? {
        let mut entry = entry?;
        let path = entry.path()?.into_owned();
        if path == Path::new(MANIFEST) {
            continue;
        }
        ensure!(entry.header().entry_type() == EntryType::Regular, "{} is not a file", path.display());
        each(&path, &mut entry)?;
    }
    Ok(())
}

/// Returns the place of a file. The paths in an archive lead nowhere else.
fn target(root: &Path, inside: &Path) -> anyhow::Result<PathBuf> {
    let is_plain = inside.components().all(|component| matches!(component, Component::Normal(_)));
    if !is_plain {
        bail!("{} is not a path of a backup", inside.display());
    }
    Ok(root.join(inside))
}

/// Writes a file. The gateway's own user has to read what an administrator restores: new directories and the file get the
/// owner of the directory that was there. A file of another user than root stays readable for the group.
fn write_file(target: &Path, entry: &mut tar::Entry<'_, File>) -> anyhow::Result<()> {
    let directory = target.parent().unwrap_or(Path::new("/"));
    let new = directory.ancestors().take_while(|directory| !directory.exists()).map(Path::to_owned).collect::<Vec<_>>();
    fs::create_dir_all(directory)?;
    let there = new.last().and_then(|first| first.parent()).unwrap_or(directory);
    let owner = fs::metadata(there)?;
    let is_root = rustix::process::geteuid().is_root();
    if is_root {
        for directory in &new {
            fchown(File::open(directory)?, Some(owner.uid()), Some(owner.gid()))?;
        }
    }
    let mut mode = entry.header().mode()? & 0o777;
    if owner.uid() == 0 && entry.header().uid()? != 0 {
        mode |= 0o040;
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(target)?;
    io::copy(entry, &mut file)?;
    file.set_permissions(fs::Permissions::from_mode(mode))?;
    file.sync_all()?;
    if is_root {
        fchown(&file, Some(owner.uid()), Some(owner.gid()))?;
    }
    Ok(())
}

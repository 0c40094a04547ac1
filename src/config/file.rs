//! The TOML file.

use std::path::{Path, PathBuf};

use super::{Content, Gripper, Mistake, Place, owned, parse_device};

/// A file that was read, with what is needed to name its lines.
#[derive(Debug)]
pub struct File {
    path: PathBuf,
    text: String,
    pub(super) content: Content,
}

impl File {
    /// Reads it.
    ///
    /// # Errors
    /// [`Mistake`], where it can't be read, or is no such TOML.
    pub fn read(path: &Path) -> Result<Self, Mistake> {
        let place = Place::File { path: owned(path), line: 1 };
        let text = std::fs::read_to_string(path).map_err(|error| Mistake::at(&place, error))?;
        Self::parse(path, text)
    }

    /// Parses a file's text.
    ///
    /// # Errors
    /// [`Mistake`], where it is no such TOML.
    pub fn parse(path: &Path, text: String) -> Result<Self, Mistake> {
        let content = toml::from_str(&text).map_err(|error: toml::de::Error| {
            let line = line_of(&text, error.span().map_or(0, |span| span.start));
            Mistake::at(&Place::File { path: owned(path), line }, error.message())
        })?;
        Ok(Self { path: owned(path), text, content })
    }

    /// The place of this byte.
    pub(super) fn place(&self, offset: usize) -> Place {
        Place::File { path: self.path.clone(), line: line_of(&self.text, offset) }
    }

    pub(super) fn grippers(&self) -> Result<Vec<Gripper>, Mistake> {
        let parse = |(name, gripper): (&toml::Spanned<String>, &super::GripperContent)| {
            let place = self.place(gripper.url.span().start);
            Ok(Gripper {
                name: name.get_ref().parse().map_err(|error| Mistake::at(&self.place(name.span().start), error))?,
                device: parse_device(gripper.url.get_ref(), &place)?,
                read_ids: gripper.read_ids.clone(),
                place,
            })
        };
        self.content.grippers.iter().map(parse).collect()
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

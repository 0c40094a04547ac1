//! A guide as a page, and as sections for the search over all guides.

use std::fmt::{self, Write as _};
use std::sync::Arc;

use comrak::nodes::{AstNode, NodeValue};
use comrak::{Anchorizer, Arena, Options, format_html, html, parse_document};
use serde::Serialize;

/// The page that lists the others.
pub const INDEX: &str = "README";

/// A part of a guide below one heading, as the search of the pages reads it.
#[derive(Debug, Serialize)]
pub struct Section {
    page: String,
    /// The first heading of the guide.
    guide: String,
    heading: String,
    anchor: String,
    text: String,
    #[serde(skip)]
    level: u8,
}

/// Returns the guide as HTML, with its contents before it.
pub fn rendered(name: &str, markdown: &str) -> Result<String, fmt::Error> {
    let arena = Arena::new();
    let root = parse_document(&arena, markdown, &options());
    let sections = sections_of(name, root);
    let mut title = String::new();
    html::escape(&mut title, sections.first().map_or(name, |section| &section.guide))?;
    let contents = contents(&sections)?;
    let mut body = String::new();
    format_html(root, &options(), &mut body)?;
    Ok(format!(
        r#"<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} · WSG Gateway</title>
<link rel="stylesheet" href="style.css">
<script type="module" src="page.js"></script>
</head>
<body>
<header>
<nav aria-label="Pages"><a href="./">Guides</a> <a href="../../docs">HTTP API</a> <a href="../../">Dashboard</a></nav>
<form id="search" role="search" hidden><label>Search all guides <input type="search" autocomplete="off" spellcheck="false"></label></form>
</header>
<section id="results" aria-label="Search results" hidden><p role="status"></p><ol></ol></section>
{contents}<main>
{body}</main>
</body>
</html>
"#
    ))
}

/// Returns the sections of a guide in their order.
pub fn sections(name: &str, markdown: &str) -> Vec<Section> {
    let arena = Arena::new();
    sections_of(name, parse_document(&arena, markdown, &options()))
}

fn sections_of<'a>(name: &str, root: &'a AstNode<'a>) -> Vec<Section> {
    // Counts equal headings as `format_html` does.
    let mut anchors = Anchorizer::new();
    let mut sections: Vec<Section> = Vec::new();
    for block in root.children() {
        if let NodeValue::Heading(heading) = &block.data.borrow().value {
            let text = block.collect_text();
            sections.push(Section {
                page: name.to_owned(),
                guide: sections.first().map_or(&text, |first| &first.guide).clone(),
                anchor: anchors.anchorize(&text),
                heading: text,
                text: String::new(),
                level: heading.level,
            });
        } else if let Some(section) = sections.last_mut() {
            section.text.push_str(&text_of(block));
        }
    }
    sections
}

/// Returns the words of a block. Words of different paragraphs, cells and lines stay apart.
fn text_of<'a>(block: &'a AstNode<'a>) -> String {
    let mut text = String::new();
    for node in block.descendants() {
        match &node.data.borrow().value {
            NodeValue::Text(words) => text.push_str(words),
            NodeValue::Code(code) => text.push_str(&code.literal),
            NodeValue::CodeBlock(code) => {
                text.push(' ');
                text.push_str(&code.literal);
            }
            NodeValue::Paragraph | NodeValue::TableCell | NodeValue::SoftBreak | NodeValue::LineBreak => text.push(' '),
            _ => {}
        }
    }
    text
}

/// Returns where the target of a guide's link is served, relative to the guide: another guide, another file of `deploy`,
/// or a path of the gateway.
fn served_at(link: &str) -> String {
    let (path, anchor) = link.split_at(link.find('#').unwrap_or(link.len()));
    if let Some(file) = path.strip_prefix("../") {
        return format!("../files/{file}");
    }
    if let Some(below) = path.strip_prefix('/') {
        return format!("../../{below}{anchor}");
    }
    match path.strip_suffix(".md") {
        Some(INDEX) => format!("./{anchor}"),
        Some(name) if !name.contains('/') => format!("{name}{anchor}"),
        _ => link.to_owned(),
    }
}

/// Returns links to the sections of a guide that has more than one.
fn contents(sections: &[Section]) -> Result<String, fmt::Error> {
    let listed: Vec<_> = sections.iter().filter(|section| matches!(section.level, 2 | 3)).collect();
    if listed.len() < 2 {
        return Ok(String::new());
    }
    let mut list =
        String::from("<nav id=\"contents\" aria-label=\"Contents\"><details><summary>Contents</summary><ul>\n");
    for section in listed {
        write!(list, "<li class=\"level-{}\"><a href=\"#{}\">", section.level, section.anchor)?;
        html::escape(&mut list, &section.heading)?;
        list.push_str("</a></li>\n");
    }
    list.push_str("</ul></details></nav>\n");
    Ok(list)
}

/// Returns the extensions that the guides use, with anchors as GitHub makes them.
fn options() -> Options<'static> {
    let mut options = Options::default();
    options.extension.table = true;
    options.extension.header_id_prefix = Some(String::new());
    options.extension.link_url_rewriter = Some(Arc::new(|link: &str| served_at(link)));
    options
}

#[cfg(test)]
mod tests {
    use super::*;

    const GUIDE: &str = "# A & guide\n\nAbout `lease_held`.\n\n## Part\n\n| a | b |\n| --- | --- |\n| one | two |\n\n\
        ## Part\n\n```sh\ncurl x\n```\n";

    #[test]
    fn sections_have_the_anchors_of_the_page() {
        let page = rendered("name", GUIDE).unwrap();
        let found = sections("name", GUIDE);
        assert_eq!(
            found.iter().map(|section| section.anchor.as_str()).collect::<Vec<_>>(),
            ["a--guide", "part", "part-1"]
        );
        for section in &found {
            assert!(page.contains(&format!("id=\"{}\"", section.anchor)), "{page}");
            assert_eq!((section.page.as_str(), section.guide.as_str()), ("name", "A & guide"));
        }
        assert!(page.contains("<title>A &amp; guide ·"), "{page}");
        assert!(page.contains(r##"<li class="level-2"><a href="#part-1">Part</a></li>"##), "{page}");
    }

    #[test]
    fn text_of_a_section_keeps_words_apart() {
        let found = sections("name", GUIDE);
        assert_eq!(found[0].text.trim(), "About lease_held.");
        assert_eq!(found[1].text.split_whitespace().collect::<Vec<_>>(), ["a", "b", "one", "two"]);
        assert_eq!(found[2].text.trim(), "curl x");
    }
}

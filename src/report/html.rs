//! Pieces of a page: escaped text, tables, and pictures inside the page itself.

use std::fmt::Write as _;

/// Text that is safe inside an element or a quoted attribute.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && c != '\n' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// Bytes as a `data:` address, so that the page needs no other file.
pub(crate) fn data_uri(media_type: &str, bytes: &[u8]) -> String {
    format!("data:{media_type};base64,{}", base64(bytes))
}

/// Base 64 of RFC 4648, padded.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let at = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let word = at(0) << 16 | at(1) << 8 | at(2);
        for sextet in 0..4_usize {
            let index = (word >> (18 - 6 * sextet)) & 63;
            out.push(if sextet <= group.len() { char::from(ALPHABET[index as usize]) } else { '=' });
        }
    }
    out
}

/// A section with its heading and what the reader should know before looking at it.
pub(crate) fn section(id: &str, heading: &str, lead: &str, body: &str) -> String {
    let lead = if lead.is_empty() { String::new() } else { format!("<p class=\"lead\">{}</p>\n", escape(lead)) };
    format!("<section id=\"{id}\">\n<h2>{}</h2>\n{lead}{body}</section>\n", escape(heading))
}

/// A list of remarks; nothing for none.
pub(crate) fn list(items: &[String]) -> String {
    if items.is_empty() {
        return String::new();
    }
    let items: String = items.iter().map(|item| format!("<li>{}</li>\n", escape(item))).collect();
    format!("<ul>\n{items}</ul>\n")
}

/// A share as a bar with its number of percent.
pub(crate) fn bar(share: f64, class: &str) -> String {
    if !share.is_finite() {
        return String::from(super::number::UNKNOWN);
    }
    let percent = share.clamp(0.0, 1.0) * 100.0;
    format!(
        "<span class=\"bar {class}\"><span style=\"width:{percent:.0}%\"></span></span><span class=\"percent\">{percent:.0}\u{202f}%</span>"
    )
}

/// How a column is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Align {
    /// Words, left.
    Text,
    /// Words that may fill several lines.
    Prose,
    /// Numbers, right, figures of one width.
    Number,
}

impl Align {
    fn class(self) -> &'static str {
        match self {
            Self::Text => "t",
            Self::Prose => "p",
            Self::Number => "n",
        }
    }
}

/// A table in a frame of its own that scrolls when the screen is narrow.
#[derive(Debug)]
pub(crate) struct Table {
    caption: String,
    groups: String,
    head: String,
    columns: Vec<Align>,
    body: String,
    rows: usize,
}

impl Table {
    /// An empty table; columns are heading, unit (or nothing), and how they are set.
    pub(crate) fn new(caption: &str, columns: &[(&str, &str, Align)]) -> Self {
        let mut head = String::new();
        for (heading, unit, align) in columns {
            let unit = if unit.is_empty() { String::new() } else { format!("<small>{}</small>", escape(unit)) };
            let _ = write!(head, "<th scope=\"col\" class=\"{}\">{}{unit}</th>", align.class(), escape(heading));
        }
        Self {
            caption: escape(caption),
            groups: String::new(),
            head,
            columns: columns.iter().map(|c| c.2).collect(),
            body: String::new(),
            rows: 0,
        }
    }

    /// Headings over several columns each.
    pub(crate) fn groups(mut self, groups: &[(&str, usize)]) -> Self {
        for (heading, span) in groups {
            let class = if heading.is_empty() { "" } else { " class=\"g\"" };
            let _ = write!(self.groups, "<th colspan=\"{span}\"{class}>{}</th>", escape(heading));
        }
        self
    }

    /// Adds a row of cells that are escaped here.
    pub(crate) fn row(&mut self, cells: &[String]) {
        let cells: Vec<String> = cells.iter().map(|c| escape(c)).collect();
        self.row_of_html("", &cells);
    }

    /// Adds a row of cells that are HTML already, under a class.
    pub(crate) fn row_of_html(&mut self, class: &str, cells: &[String]) {
        let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
        let _ = write!(self.body, "<tr{class}>");
        for (i, (cell, align)) in cells.iter().zip(&self.columns).enumerate() {
            let (open, close) = if i == 0 { ("th scope=\"row\"", "th") } else { ("td", "td") };
            let _ = write!(self.body, "<{open} class=\"{}\">{cell}</{close}>", align.class());
        }
        self.body.push_str("</tr>\n");
        self.rows += 1;
    }

    /// The table; nothing when it has no row.
    pub(crate) fn html(self) -> String {
        if self.rows == 0 {
            return String::new();
        }
        let groups = if self.groups.is_empty() { String::new() } else { format!("<tr>{}</tr>\n", self.groups) };
        format!(
            "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{0}\">\n<table>\n<caption>{0}</caption>\n<thead>\n{groups}<tr>{1}</tr>\n</thead>\n<tbody>\n{2}</tbody>\n</table>\n</div>\n",
            self.caption, self.head, self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escape("<b a='1' b=\"2\">&\u{7}"), "&lt;b a=&#39;1&#39; b=&quot;2&quot;&gt;&amp;\u{fffd}");
    }

    #[test]
    fn base64_agrees_with_the_vectors_of_rfc_4648() {
        for (plain, coded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[255, 254, 253]), "//79");
    }

    #[test]
    fn a_table_escapes_its_cells_and_is_left_out_when_empty() {
        let mut table = Table::new("Strips", &[("Strip", "", Align::Text), ("Length", "m", Align::Number)]);
        table.row(&[String::from("<1>"), String::from("2")]);
        let html = table.html();
        assert!(html.contains("<th scope=\"row\" class=\"t\">&lt;1&gt;</th><td class=\"n\">2</td>"));
        assert!(html.contains("Length<small>m</small>"));
        assert!(Table::new("Nothing", &[("Strip", "", Align::Text)]).html().is_empty());
    }
}

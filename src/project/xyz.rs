//! `xyz` in `[match]`: which kinds of XYZ points are looked for.

use serde::{Deserialize, Serialize};

use super::MatchSection;

/// A kind of XYZ points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum XyzWord {
    /// Spots of pavement by their brightness.
    Texture,
    /// Where three planes meet, and ridges, where two do.
    Corner,
    /// Poles and trunks.
    Pole,
    /// Tiles registered by all their surfaces.
    Submap,
}

impl XyzWord {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Texture, Self::Corner, Self::Pole, Self::Submap];
    /// Those that there are for drives.
    pub const OF_DRIVES: &[Self] = &[Self::Texture, Self::Corner, Self::Pole];
    /// Those of drives that `"auto"` takes: sigmas of corners and poles have been judged on few drives yet.
    pub const AUTO_OF_DRIVES: &[Self] = &[Self::Texture];
    /// Those that there are for strips.
    pub const OF_STRIPS: &[Self] = &[Self::Corner, Self::Submap];

    /// The word in the project file.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Texture => "texture",
            Self::Corner => "corner",
            Self::Pole => "pole",
            Self::Submap => "submap",
        }
    }

    /// What a person should know of it.
    #[must_use]
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Texture => "spots of pavement that several sightings show alike",
            Self::Corner => "corners where planes meet",
            Self::Pole => "posts and trunks",
            Self::Submap => "tiles registered by all their surfaces",
        }
    }
}

/// `xyz`: `"off"`, `"auto"` or a list of kinds.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "XyzWords", into = "XyzWords")]
pub enum XyzChoice {
    /// None.
    #[default]
    Off,
    /// For drives [`XyzWord::AUTO_OF_DRIVES`], for strips [`XyzWord::OF_STRIPS`].
    Auto,
    /// These, in order.
    Kinds(Vec<XyzWord>),
}

impl XyzChoice {
    /// Whether a kind is looked for in a drive.
    #[must_use]
    pub fn has(&self, word: XyzWord) -> bool {
        self.kinds(true).contains(&word)
    }

    /// The kinds that a drive, or strips, look for.
    #[must_use]
    pub fn kinds(&self, is_drive: bool) -> Vec<XyzWord> {
        let there = if is_drive { XyzWord::OF_DRIVES } else { XyzWord::OF_STRIPS };
        let asked: &[XyzWord] = match self {
            Self::Off => &[],
            Self::Auto if is_drive => XyzWord::AUTO_OF_DRIVES,
            Self::Auto => XyzWord::OF_STRIPS,
            Self::Kinds(kinds) => kinds,
        };
        there.iter().copied().filter(|k| asked.contains(k)).collect()
    }

    /// The first kind asked for by name that is not there for a drive, or for strips, and what to do.
    fn not_there(&self, is_drive: bool) -> Option<(String, String)> {
        let Self::Kinds(kinds) = self else { return None };
        let (there, of) = if is_drive { (XyzWord::OF_DRIVES, "drives") } else { (XyzWord::OF_STRIPS, "strips") };
        let other = kinds.iter().find(|k| !there.contains(k))?;
        let words: Vec<String> = there.iter().map(|k| format!("\"{}\"", k.as_str())).collect();
        let remedy = format!("for {of} there are {}: take those, \"auto\" or \"off\"", words.join(" and "));
        Some((format!("[.., \"{}\"]", other.as_str()), remedy))
    }
}

/// What is wrong with the choice of kinds in a drive, or in strips: key, value, what to do.
pub(super) fn wrong(section: &MatchSection, is_drive: bool) -> Option<(&'static str, String, String)> {
    if let Some((value, remedy)) = section.xyz.not_there(is_drive) {
        return Some(("match.xyz", value, remedy));
    }
    if section.surface_lines != Some(false) {
        return None;
    }
    let remedy = match (is_drive, &section.xyz) {
        (true, _) => "drives live on surface lines: leave it out",
        (false, XyzChoice::Off) => "nothing is left to tie the strips with: give match.xyz as well",
        (false, _) => return None,
    };
    Some(("match.surface_lines", String::from("false"), String::from(remedy)))
}

/// `xyz` as it is written.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum XyzWords {
    One(String),
    Several(Vec<String>),
}

impl TryFrom<XyzWords> for XyzChoice {
    type Error = String;

    fn try_from(words: XyzWords) -> Result<Self, String> {
        const DUE: &str = "\"auto\", \"off\" or a list of \"corner\", and \"texture\" and \"pole\" (drives) or \"submap\" (strips), is due";
        match words {
            XyzWords::One(word) => match word.as_str() {
                "off" => Ok(Self::Off),
                "auto" => Ok(Self::Auto),
                other => Err(format!("match.xyz = \"{other}\" is not known: {DUE}")),
            },
            XyzWords::Several(words) => {
                let kind = |word: &String| {
                    let known = XyzWord::ALL.into_iter().find(|k| k.as_str() == word);
                    known.ok_or_else(|| format!("match.xyz: \"{word}\" is not known: {DUE}"))
                };
                let mut kinds = words.iter().map(kind).collect::<Result<Vec<_>, _>>()?;
                kinds.sort_unstable();
                kinds.dedup();
                Ok(if kinds.is_empty() { Self::Off } else { Self::Kinds(kinds) })
            }
        }
    }
}

impl From<XyzChoice> for XyzWords {
    fn from(choice: XyzChoice) -> Self {
        match choice {
            XyzChoice::Off => Self::One(String::from("off")),
            XyzChoice::Auto => Self::One(String::from("auto")),
            XyzChoice::Kinds(kinds) => Self::Several(kinds.iter().map(|k| k.as_str().to_string()).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::parse_str;

    fn section(line: &str) -> Result<MatchSection, String> {
        toml::from_str(line).map_err(|error| error.to_string())
    }

    #[test]
    fn kinds_of_points_are_read_and_written_again() {
        use XyzWord::{Corner, Submap, Texture};
        for (line, due) in [
            ("", XyzChoice::Off),
            ("xyz = \"off\"", XyzChoice::Off),
            ("xyz = []", XyzChoice::Off),
            ("xyz = \"auto\"", XyzChoice::Auto),
            ("xyz = [\"texture\"]", XyzChoice::Kinds(vec![Texture])),
            ("xyz = [\"submap\", \"corner\", \"submap\"]", XyzChoice::Kinds(vec![Corner, Submap])),
        ] {
            let read = section(line).expect("known words");
            assert_eq!(read.xyz, due);
            let written = toml::to_string(&read).expect("written");
            assert_eq!(section(&written), Ok(read));
        }
    }

    #[test]
    fn automatic_is_what_there_is() {
        assert_eq!(XyzChoice::Auto.kinds(true), [XyzWord::Texture]);
        assert_eq!(XyzChoice::Auto.kinds(false), [XyzWord::Corner, XyzWord::Submap]);
        assert!(XyzChoice::Off.kinds(false).is_empty());
        assert_eq!(XyzChoice::Kinds(vec![XyzWord::Submap]).kinds(false), [XyzWord::Submap]);
    }

    #[test]
    fn unknown_kinds_are_refused_with_those_that_are_due() {
        for (line, word) in
            [("xyz = \"texture\"", "\"texture\" is not known"), ("xyz = [\"textur\"]", "\"textur\" is not known")]
        {
            let error = section(line).expect_err("refused");
            assert!(error.contains(word) && error.contains("\"auto\", \"off\" or a list"), "{error}");
        }
    }

    #[test]
    fn kinds_that_are_not_there_are_refused_with_those_that_are() {
        let strips = "[[strips]]\npath = \"*.laz\"\n";
        let drive = "[[strips]]\npath = \"*.laz\"\n[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n";
        let parsed = |first: &str, list: &str| parse_str(&format!("{first}[match]\nxyz = {list}\n"));
        assert!(parsed(strips, "[\"corner\", \"submap\"]").is_ok() && parsed(drive, "[\"texture\"]").is_ok());
        for (first, list, words) in [
            (strips, "[\"submap\", \"texture\"]", ["match.xyz", "\"texture\"", "for strips there are"]),
            (strips, "[\"pole\"]", ["match.xyz", "\"pole\"", "\"corner\" and \"submap\""]),
            (
                drive,
                "[\"submap\"]",
                ["match.xyz", "\"submap\"", "for drives there are \"texture\" and \"corner\" and \"pole\""],
            ),
        ] {
            let message = parsed(first, list).expect_err("refused").to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
    }

    #[test]
    fn without_surface_lines_something_must_tie_the_strips() {
        let strips = "[[strips]]\npath = \"*.laz\"\n[match]\nsurface_lines = false\n";
        let message = parse_str(strips).expect_err("refused").to_string();
        assert!(message.contains("match.surface_lines") && message.contains("match.xyz"), "{message}");
        assert!(parse_str(&format!("{strips}xyz = \"auto\"\n")).is_ok());
        let drive = strips.replace("[match]", "[imu]\npath = \"imu.txt\"\ngrade = \"ap60\"\n[match]\nxyz = \"auto\"");
        let message = parse_str(&drive).expect_err("refused").to_string();
        assert!(message.contains("match.surface_lines") && message.contains("drives"), "{message}");
    }
}

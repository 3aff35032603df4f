//! `xyz` in `[match]`: which kinds of XYZ points are looked for.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// `xyz`: `"off"`, `"auto"` or a list of kinds.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "XyzWords", into = "XyzWords")]
pub enum XyzChoice {
    /// None.
    #[default]
    Off,
    /// Texture for drives, none for strips: what corners and poles cost is not within its bound yet.
    Auto,
    /// These.
    Kinds(BTreeSet<XyzWord>),
}

/// A kind of XYZ points that jobs look for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum XyzWord {
    /// Texture of pavement.
    Texture,
    /// Corners of walls and ground.
    Corner,
    /// Posts and trunks.
    Pole,
}

impl XyzWord {
    /// All of them.
    const ALL: [Self; 3] = [Self::Texture, Self::Corner, Self::Pole];

    /// As it is written.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Texture => "texture",
            Self::Corner => "corner",
            Self::Pole => "pole",
        }
    }

    /// What a person should know of it.
    #[must_use]
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Texture => "spots of pavement that several sightings show alike",
            Self::Corner => "corners of walls and ground",
            Self::Pole => "posts and trunks",
        }
    }
}

impl XyzChoice {
    /// Whether a kind is looked for in a drive.
    #[must_use]
    pub fn has(&self, word: XyzWord) -> bool {
        match self {
            Self::Off => false,
            Self::Auto => word == XyzWord::Texture,
            Self::Kinds(words) => words.contains(&word),
        }
    }

    /// The kinds that are looked for in a drive.
    pub fn words(&self) -> impl Iterator<Item = XyzWord> {
        XyzWord::ALL.into_iter().filter(|word| self.has(*word))
    }
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
        const DUE: &str = "\"auto\", \"off\" or a list of \"texture\", \"corner\", \"pole\" is due";
        let known = |word: &String| XyzWord::ALL.into_iter().find(|w| w.as_str() == word);
        match words {
            XyzWords::One(word) => match word.as_str() {
                "off" => Ok(Self::Off),
                "auto" => Ok(Self::Auto),
                other => Err(format!("match.xyz = \"{other}\" is not known: {DUE}")),
            },
            XyzWords::Several(words) => match words.iter().find(|w| known(w).is_none()) {
                None if words.is_empty() => Ok(Self::Off),
                None => Ok(Self::Kinds(words.iter().filter_map(known).collect())),
                Some(word) if word == "submap" => {
                    Err(format!("match.xyz: \"{word}\" is not there for jobs yet: {DUE}"))
                }
                Some(word) => Err(format!("match.xyz: \"{word}\" is not known: {DUE}")),
            },
        }
    }
}

impl From<XyzChoice> for XyzWords {
    fn from(choice: XyzChoice) -> Self {
        match choice {
            XyzChoice::Off => Self::One(String::from("off")),
            XyzChoice::Auto => Self::One(String::from("auto")),
            XyzChoice::Kinds(words) => Self::Several(words.into_iter().map(|w| String::from(w.as_str())).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::project::MatchSection;

    fn section(line: &str) -> Result<MatchSection, String> {
        toml::from_str(line).map_err(|error| error.to_string())
    }

    #[test]
    fn kinds_of_points_are_read_and_written_again() {
        let kinds = |words: &[XyzWord]| XyzChoice::Kinds(words.iter().copied().collect());
        for (line, due, found) in [
            ("", XyzChoice::Off, vec![]),
            ("xyz = \"off\"", XyzChoice::Off, vec![]),
            ("xyz = []", XyzChoice::Off, vec![]),
            ("xyz = \"auto\"", XyzChoice::Auto, vec![XyzWord::Texture]),
            ("xyz = [\"texture\"]", kinds(&[XyzWord::Texture]), vec![XyzWord::Texture]),
            (
                "xyz = [\"pole\", \"texture\"]",
                kinds(&[XyzWord::Texture, XyzWord::Pole]),
                vec![XyzWord::Texture, XyzWord::Pole],
            ),
        ] {
            let read = section(line).expect("known words");
            assert_eq!((read.xyz.words().collect::<Vec<_>>(), &read.xyz), (found, &due));
            let written = toml::to_string(&read).expect("written");
            assert_eq!(section(&written), Ok(read));
        }
    }

    #[test]
    fn unknown_kinds_are_refused_with_those_that_are_due() {
        for (line, word) in [
            ("xyz = \"texture\"", "\"texture\" is not known"),
            ("xyz = [\"textur\"]", "\"textur\" is not known"),
            ("xyz = [\"texture\", \"submap\"]", "\"submap\" is not there for jobs yet"),
        ] {
            let error = section(line).expect_err("refused");
            assert!(error.contains(word) && error.contains("\"auto\", \"off\" or a list of \"texture\","), "{error}");
        }
    }
}

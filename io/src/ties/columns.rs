//! The kinds of columns that a table of ties is made of.

use std::collections::HashMap;

/// A column of texts that repeat: every text is kept once.
#[derive(Debug, Clone, Default)]
pub struct TextColumn {
    texts: Vec<String>,
    number_of: HashMap<String, u32>,
    rows: Vec<u32>,
}

impl TextColumn {
    /// Adds a row.
    ///
    /// # Panics
    /// Never in practice: it would take four thousand million different texts.
    #[allow(clippy::expect_used)]
    pub fn push(&mut self, text: &str) {
        let number = match self.number_of.get(text) {
            Some(number) => *number,
            None => {
                let number = u32::try_from(self.texts.len()).expect("fewer texts than memory");
                self.texts.push(text.to_string());
                self.number_of.insert(text.to_string(), number);
                number
            }
        };
        self.rows.push(number);
    }
    /// The text of a row.
    ///
    /// # Panics
    /// When there is no such row.
    #[must_use]
    pub fn get(&self, row: usize) -> &str {
        &self.texts[self.rows[row] as usize]
    }
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }
    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
    /// The texts, row by row.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.rows.iter().map(|&number| self.texts[number as usize].as_str())
    }
}

impl PartialEq for TextColumn {
    fn eq(&self, other: &Self) -> bool {
        self.iter().eq(other.iter())
    }
}

/// A column to be written.
#[derive(Debug, Clone, Copy)]
pub(super) enum Column<'a> {
    Long(&'a [i64]),
    Int(&'a [i32]),
    /// NaN where unknown.
    Double(&'a [f64]),
    Flag(&'a [bool]),
    Text(&'a TextColumn),
}

/// A column to be read into.
#[derive(Debug)]
pub(super) enum ColumnMut<'a> {
    Long(&'a mut Vec<i64>),
    Int(&'a mut Vec<i32>),
    Double(&'a mut Vec<f64>),
    Flag(&'a mut Vec<bool>),
    Text(&'a mut TextColumn),
}

impl Column<'_> {
    /// Declaration in a Parquet schema, without the name.
    pub(super) fn parquet_type(&self) -> (&'static str, &'static str) {
        match self {
            Self::Long(_) => ("REQUIRED INT64", ""),
            Self::Int(_) => ("REQUIRED INT32", ""),
            Self::Double(_) => ("OPTIONAL DOUBLE", ""),
            Self::Flag(_) => ("REQUIRED BOOLEAN", ""),
            Self::Text(_) => ("REQUIRED BYTE_ARRAY", " (UTF8)"),
        }
    }
}

/// A column of any kind, as a file sees it.
pub(super) trait Store {
    fn view(&self) -> Column<'_>;
    fn view_mut(&mut self) -> ColumnMut<'_>;
}

macro_rules! store {
    ($store:ty, $kind:ident) => {
        impl Store for $store {
            fn view(&self) -> Column<'_> {
                Column::$kind(self)
            }
            fn view_mut(&mut self) -> ColumnMut<'_> {
                ColumnMut::$kind(self)
            }
        }
    };
}
store!(Vec<i64>, Long);
store!(Vec<i32>, Int);
store!(Vec<f64>, Double);
store!(Vec<bool>, Flag);
store!(TextColumn, Text);

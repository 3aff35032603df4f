//! The sections of the page, in the order of the page.

pub(crate) mod adjustment;
pub(crate) mod headline;
pub(crate) mod maps;
pub(crate) mod pairs;
pub(crate) mod record;
pub(crate) mod strips;
pub(crate) mod ties;

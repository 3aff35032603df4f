//! The stages of a job, in their order: scan → trajectory → ties → solve → correct.

pub mod correct;
pub mod difference;
pub mod drive;
pub mod given_ties;
pub mod navigate;
pub mod places;
pub mod scan;
pub mod solve;
pub mod stations;
pub mod texture;
pub mod ties;
pub mod trajectory;

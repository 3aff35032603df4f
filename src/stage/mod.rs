//! The stages of a job, in their order: scan → trajectory → ties → solve → correct.

pub mod corners;
pub mod correct;
pub mod difference;
pub mod drive;
pub mod given_ties;
mod leave_out;
pub mod navigate;
pub mod nearby;
pub mod places;
pub mod poles;
pub mod scan;
pub mod search;
pub mod solve;
pub mod stations;
pub mod texture;
pub mod ties;
pub mod trajectory;

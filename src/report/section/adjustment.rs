//! The adjustment: its parameters, what the strips can tell of them, and the models that were tried.

use crate::report::data::{ParameterSummary, Summary};
use crate::report::html::{Align, Table, bar, escape, list, section};
use crate::report::number::{decimals_for, fixed, length, mm, signed};

/// Most rows; `summary.json` has them all.
const MOST_ROWS: usize = 400;

const LEAD: &str = "Values of the sensor's mounting and ranges with their standard deviations (sigma). Known from ties says how \
much of a value comes from this survey: at 100 % the ties alone decide, at 0 % it is the value assumed beforehand and its sigma \
is the one assumed (prior).";
const TRIAL_LEAD: &str = "A model with more freedom fits the ties it is given better in any case. It was taken only where ties \
that it was not given agree that it is better, by more than one standard error of that improvement: the gain counts them.";

/// Parameters and what is held by the prior.
pub(crate) fn calibration(summary: &Summary) -> String {
    let c = &summary.calibration;
    if c.iterations == 0 && c.parameters.is_empty() && c.strip_model.is_empty() {
        return String::new();
    }
    // the mounting first, for it is what a survey is calibrated for; the many rows of strips folded away
    let (of_strips, of_mounting): (Vec<_>, Vec<_>) = c.parameters.iter().partition(|p| p.block.starts_with("strip "));
    let mut body = parameters("Calibration parameters", &of_mounting);
    let strips = parameters("Corrections of the strips, as parameters", &of_strips);
    if !strips.is_empty() {
        let n = length(of_strips.len());
        body += &format!("<details><summary>Corrections of the strips: {n} parameters</summary>\n{strips}</details>\n");
    }
    body += "<h3>What these strips cannot tell</h3>\n";
    body += if c.unobservable.is_empty() {
        "<p>Nothing: every parameter that was estimated is determined by the ties.</p>\n"
    } else {
        "<p>The geometry of the survey does not separate the following. They kept to the values assumed beforehand, and points do not move because of them; other flight directions, heights or control would tell them apart.</p>\n"
    };
    body += &list(&c.unobservable);
    body += "<h3>The adjustment in figures</h3>\n";
    body += &figures(summary);
    section("calibration", "Calibration", LEAD, &body)
}

fn parameters(title: &str, of: &[&ParameterSummary]) -> String {
    let mut table = Table::new(
        title,
        &[
            ("Of", "", Align::Text),
            ("Parameter", "", Align::Text),
            ("Value", "", Align::Number),
            ("Sigma", "", Align::Number),
            ("Prior sigma", "", Align::Number),
            ("Unit", "", Align::Text),
            ("Known from ties", "", Align::Text),
        ],
    );
    for parameter in of.iter().take(MOST_ROWS) {
        table.row_of_html("", &row(parameter));
    }
    let mut body = table.html();
    if of.len() > MOST_ROWS {
        body += &format!("<p>The first {MOST_ROWS} of {} parameters.</p>\n", length(of.len()));
    }
    body
}

fn row(p: &ParameterSummary) -> Vec<String> {
    let decimals = decimals_for(p.sigma);
    let class = match p.observed {
        share if share >= 0.9 => "good",
        share if share >= 0.5 => "partly",
        _ => "prior",
    };
    vec![
        escape(&p.block),
        escape(&p.name.replace('_', " ")),
        signed(p.value, decimals),
        fixed(p.sigma, decimals),
        fixed(p.prior_sigma, decimals_for(p.prior_sigma).min(decimals)),
        escape(&p.unit),
        bar(p.observed, class),
    ]
}

fn figures(summary: &Summary) -> String {
    let c = &summary.calibration;
    let mut table = Table::new(
        "The adjustment in figures",
        &[("Figure", "", Align::Text), ("Value", "", Align::Number), ("Meaning", "", Align::Prose)],
    );
    let mut tell = |name: &str, value: String, meaning: &str| {
        table.row(&[String::from(name), value, String::from(meaning)]);
    };
    tell("Strip model", c.strip_model.clone(), "how the correction of a strip may change along it");
    tell("Rounds", length(c.iterations), "the ties were measured anew in each");
    tell("Sigma of unit weight", fixed(c.sigma0, 3), "1 where the ties are as good as their sigmas say");
    tell("Outliers", length(c.outliers), "observations taken out by the outlier test");
    let meaning = "factor on all sigmas for errors that ties near in time have in common";
    tell("Common-error factor", fixed(c.common_mode_factor, 2), meaning);
    let condition = if c.condition.is_finite() { format!("{:.1e}", c.condition) } else { String::from("–") };
    tell("Condition", condition, "largest over smallest information, in units of the prior");
    for (class, scale) in &c.class_scale {
        let name = format!("Sigma factor: {}", class.replace('_', " "));
        tell(&name, fixed(*scale, 2), "sigma of these ties found, over the one assumed");
    }
    table.html()
}

/// Models tried.
pub(crate) fn trials(summary: &Summary) -> String {
    let mut table = Table::new(
        "Models tried",
        &[
            ("Model", "", Align::Text),
            ("Unknowns", "", Align::Number),
            ("Used, rms", "mm", Align::Number),
            ("Held out, rms", "mm", Align::Number),
            ("Gain", "standard errors", Align::Number),
            ("Taken", "", Align::Text),
            ("Why", "", Align::Prose),
        ],
    );
    for trial in &summary.calibration.trials {
        table.row_of_html(
            if trial.taken { "taken" } else { "" },
            &[
                escape(&trial.model),
                length(trial.unknowns),
                mm(trial.used_rms_m),
                mm(trial.held_out_rms_m),
                signed(trial.gain_t, 1),
                String::from(if trial.taken { "✓ yes" } else { "no" }),
                escape(&trial.reason),
            ],
        );
    }
    let body = table.html();
    if body.is_empty() { body } else { section("models", "Models tried", TRIAL_LEAD, &body) }
}

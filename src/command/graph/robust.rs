//! Kernels by their names.

use anyhow::{Result, bail};
use tieline_graph::Problem;
use tieline_graph::nonlinear::{SolveOptions, Solved};
use tieline_graph::robust::Kernel;
use tieline_graph::system::{System, SystemError};

/// How ties are kept from harm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Robust {
    /// One kernel throughout.
    Kernel(Kernel),
    /// Graduated non-convexity with Geman-McClure's kernel of this scale.
    Gnc(f64),
    /// Data snooping with this limit of the test.
    Snooping(f64),
}

/// A kernel by its name: `none`, `huber:1.5`, `dcs`, ….
///
/// # Errors
/// When the name or its number makes no sense.
pub(super) fn parse(text: &str) -> Result<Robust> {
    let (name, number) = text.split_once(':').map_or((text, None), |(n, v)| (n, Some(v)));
    let scale = match number {
        None => 1.0,
        Some(word) => match word.parse::<f64>() {
            Ok(v) if v.is_finite() && v > 0.0 => v,
            _ => bail!("--robust {text}: `{word}` must be a number above 0"),
        },
    };
    Ok(match name {
        "none" => Robust::Kernel(Kernel::None),
        "huber" => Robust::Kernel(Kernel::Huber(scale)),
        "cauchy" => Robust::Kernel(Kernel::Cauchy(scale)),
        // a switch with a prior of weight Φ, eliminated, is DCS with the same Φ
        "dcs" | "switch" => Robust::Kernel(Kernel::Dcs(scale)),
        "gnc" => Robust::Gnc(scale),
        "snooping" => Robust::Snooping(if number.is_some() { scale } else { tieline_graph::snooping::LIMIT }),
        _ => bail!("--robust {text}: there are none, huber, cauchy, dcs, switch, gnc, snooping"),
    })
}

impl Robust {
    /// The kernel at the end.
    #[must_use]
    pub(super) fn kernel(self) -> Kernel {
        match self {
            Self::Kernel(kernel) => kernel,
            Self::Gnc(c) => Kernel::GemanMcClure(c * c),
            Self::Snooping(_) => Kernel::None,
        }
    }
    /// Adjusts.
    ///
    /// # Errors
    /// [`SystemError`].
    pub(super) fn solve(
        self,
        problem: &mut Problem,
        system: &mut System,
        options: &SolveOptions,
        solve: impl Fn(&mut Problem, &mut System, &SolveOptions) -> Result<Solved, SystemError>,
    ) -> Result<Solved, SystemError> {
        match self {
            Self::Kernel(kernel) => tieline_graph::robust::in_stages(problem, kernel, |problem, kernel| {
                solve(problem, system, &SolveOptions { kernel, ..options.clone() })
            }),
            // by its own way, which takes factors out of the problem
            Self::Snooping(_) => solve(problem, system, options),
            Self::Gnc(c) => tieline_graph::robust::graduated(problem, c, |problem, kernel| {
                solve(problem, system, &SolveOptions { kernel, ..options.clone() })
            }),
        }
    }
}

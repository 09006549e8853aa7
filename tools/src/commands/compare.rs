//! `brickfell compare`: how far two pictures are from each other.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args as ClapArgs;

use super::CommandError;
use super::database::print;
use super::say::spinner;
use crate::metrics::{Errors, LinearImage, compare, heat};
use crate::picture_file::{Image, load_linear};

/// Arguments of `brickfell compare`.
#[derive(ClapArgs, Clone, Debug)]
pub struct Args {
    /// A picture: PNG, JPEG, BMP, TGA or TIFF
    #[arg(value_name = "A.png")]
    pub a: PathBuf,
    /// Another one of the same size
    #[arg(value_name = "B.png")]
    pub b: PathBuf,
    /// PNG to write: heat map of FLIP, black where nobody sees a difference, over blue, red, yellow to white
    #[arg(long, value_name = "DIFF.png")]
    pub out: Option<PathBuf>,
    /// Print JSON: rmse, psnr, psnr_srgb, flip, worst, share_over_2
    #[arg(long)]
    pub json: bool,
}

fn load(path: &Path) -> Result<LinearImage, CommandError> {
    load_linear(path).map_err(|e| {
        CommandError::new(
            e,
            "compare takes two pictures, for instance of `brickfell render`",
        )
    })
}

/// Runs the command.
///
/// # Errors
/// Pictures that cannot be read or have different sizes, a difference picture that cannot be written.
pub fn run(args: &Args) -> Result<ExitCode, CommandError> {
    let comparing = spinner("comparing");
    let (a, b) = (load(&args.a)?, load(&args.b)?);
    let (errors, map) = compare(&a, &b).map_err(|e| {
        let message = format!("{} and {}: {e}", args.a.display(), args.b.display());
        CommandError::new(message, "`render --size` makes pictures of one size")
    })?;
    if let Some(out) = &args.out {
        let image = Image {
            width: a.width,
            height: a.height,
            rgb: map.into_iter().flat_map(heat).collect(),
        };
        image
            .save(out)
            .map_err(|e| CommandError::new(format!("{}: {e}", out.display()), "is the folder there?"))?;
    }
    comparing.finish_and_clear();
    if args.json {
        print(&(serde_json::to_string_pretty(&errors)? + "\n"))?;
        return Ok(ExitCode::SUCCESS);
    }
    let Errors {
        rmse,
        psnr,
        psnr_srgb,
        flip,
        worst,
        share_over_2,
    } = errors;
    print(&format!(
        "RMSE         {rmse:.6} linear light\n\
         PSNR         {psnr:.2} dB linear light, {psnr_srgb:.2} dB sRGB\n\
         FLIP         {flip:.5} mean\n\
         worst pixel  {} of 255 sRGB steps at ({}, {})\n\
         over 2/255   {:.3} % of the pixels\n",
        worst.steps,
        worst.x,
        worst.y,
        100.0 * share_over_2,
    ))?;
    Ok(ExitCode::SUCCESS)
}

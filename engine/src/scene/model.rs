//! Models: a 4DGaussians folder or a static INRIA PLY, and how a marked copy of either is written.

use std::fs;
use std::path::{Path, PathBuf};

use super::cfg_args::DeformConfig;
use super::deformation::{DeformationWeights, derive_config};
use super::gaussians::Gaussians;
use super::ply::{PlyFile, encode};
use super::pth::{PthContent, Tensor};
use super::{bad_data, read_file};
use crate::error::EngineError;

const CFG_ARGS: &str = "cfg_args";
const POINT_CLOUD: &str = "point_cloud";
const ITERATION: &str = "iteration_";
const PLY_NAME: &str = "point_cloud.ply";
const DEFORMATION: &str = "deformation.pth";
const TABLE: &str = "deformation_table.pth";
const ACCUM: &str = "deformation_accum.pth";

const WHITE: [f32; 3] = [1.0; 3];
const BLACK: [f32; 3] = [0.0; 3];

/// Extensions of files that hold splats; an unmarked one must not travel with a marked model.
const SPLAT_EXTENSIONS: [&str; 7] = ["ply", "splat", "splatv", "spz", "sog", "ksplat", "glb"];

/// Start of the names of training checkpoints, which hold the splats too.
const CHECKPOINT: &str = "chkpnt";

/// A model as loaded: splats, their deformation, and the files they came from.
#[derive(Clone, Debug)]
pub struct Model {
    /// Canonical splats.
    pub gaussians: Gaussians,
    /// Deformation network; `None` for a static model.
    pub deformation: Option<DeformationWeights>,
    /// Background colour that the model was trained on.
    pub background: [f32; 3],
    /// What was assumed because the files do not say it; to be shown to the user.
    pub warnings: Vec<String>,
    ply: PlyFile,
    layout: Layout,
}

/// The files of a model.
#[derive(Clone, Debug)]
enum Layout {
    /// A PLY on its own.
    Static,
    /// A 4DGaussians output folder and the iteration folder in use, relative to it.
    Folder { root: PathBuf, iteration: PathBuf },
}

/// What [`Model::write_marked`] did, with paths relative to the model.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The PLY that was written with new SH values.
    pub marked: PathBuf,
    /// Files that were copied byte for byte.
    pub copied: Vec<PathBuf>,
    /// Entries that stayed behind: other folders, and files with unmarked splats.
    pub left_out: Vec<PathBuf>,
}

impl Model {
    /// Loads a 4DGaussians folder (its largest iteration) or a static PLY.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] and [`EngineError::Io`] naming the file, [`EngineError::BadData`] naming file and
    /// field when a file is malformed or the files of a folder contradict each other.
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        let expected = "a 4DGaussians folder or an INRIA PLY file";
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => Self::open_folder(path),
            Ok(_) => Self::open_static(path),
            Err(source) if source.kind() == std::io::ErrorKind::NotFound => {
                Err(EngineError::MissingInput { path: path.to_path_buf(), expected: expected.to_owned() })
            }
            Err(source) => Err(io_error(path, source)),
        }
    }

    fn open_static(path: &Path) -> Result<Self, EngineError> {
        Self::of_ply(PlyFile::open(path)?, BLACK)
    }

    /// A static model that no file holds yet; `name` is what it is written as.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for splats that no file may hold, as ones that are not finite.
    pub fn of_splats(name: &Path, gaussians: &Gaussians, background: [f32; 3]) -> Result<Self, EngineError> {
        Self::of_ply(PlyFile::parse(name, encode(gaussians))?, background)
    }

    fn of_ply(ply: PlyFile, background: [f32; 3]) -> Result<Self, EngineError> {
        Ok(Self {
            gaussians: ply.decode()?,
            deformation: None,
            background,
            warnings: Vec::new(),
            ply,
            layout: Layout::Static,
        })
    }

    fn open_folder(root: &Path) -> Result<Self, EngineError> {
        let iteration = largest_iteration(root)?;
        let folder = root.join(&iteration);
        let ply = PlyFile::open(&folder.join(PLY_NAME))?;
        let gaussians = ply.decode()?;
        let weights_path = folder.join(DEFORMATION);
        let expected = "the deformation network of a 4DGaussians folder (a static model is given as its .ply)";
        let bytes = read_file(&weights_path, expected)?;
        let PthContent::StateDict(tensors) = PthContent::parse(&weights_path, &bytes)? else {
            return Err(bad_data(&weights_path, "root", "a bare tensor", "a state dict"));
        };
        let mut warnings = Vec::new();
        let cfg_path = root.join(CFG_ARGS);
        let config = if cfg_path.exists() {
            let config = DeformConfig::open(&cfg_path)?;
            check_degree(&cfg_path, &config, &gaussians)?;
            config
        } else {
            warnings.push(format!(
                "{}: not found; sizes were derived from {DEFORMATION}, and motion of position, scale and \
                 rotation over white was assumed (opacity and SH static)",
                cfg_path.display()
            ));
            DeformConfig { sh_degree: gaussians.sh_degree, ..derive_config(&weights_path, &tensors)? }
        };
        check_training_tensor(&folder.join(TABLE), &[gaussians.len()])?;
        check_training_tensor(&folder.join(ACCUM), &[gaussians.len(), 3])?;
        let background = if config.white_background { WHITE } else { BLACK };
        let deformation = DeformationWeights::from_state_dict(&weights_path, tensors, config)?;
        Ok(Self {
            gaussians,
            deformation: Some(deformation),
            background,
            warnings,
            ply,
            layout: Layout::Folder { root: root.to_path_buf(), iteration },
        })
    }

    /// The PLY file that holds the splats.
    #[must_use]
    pub fn ply(&self) -> &PlyFile {
        &self.ply
    }

    /// Writes a copy of the model with other SH coefficients into the folder `out_dir`, which may exist.
    ///
    /// The layout is kept and the PLY changes only in its `f_dc_*` and `f_rest_*` bytes. Files beside it and beside
    /// `cfg_args` are copied byte for byte, except those that hold splats themselves (other PLYs, checkpoints, other
    /// iterations): they are unmarked, and whoever receives the copy must not find them in it.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[N,16,3\] coefficient-major
    ///
    /// # Errors
    /// Those of [`PlyFile::with_sh`]; [`EngineError::Io`] naming the file that could not be read or written.
    pub fn write_marked(&self, out_dir: &Path, sh_coeffs: &[f32]) -> Result<Written, EngineError> {
        let marked = self.ply.with_sh(sh_coeffs)?;
        let mut written = Written::default();
        match &self.layout {
            Layout::Static => {
                let name = self.ply.path().file_name();
                written.marked = name.map_or_else(|| PLY_NAME.into(), PathBuf::from);
                create_dir(out_dir)?;
            }
            Layout::Folder { root, iteration } => {
                written.marked = iteration.join(PLY_NAME);
                for folder in [Path::new(""), Path::new(POINT_CLOUD), iteration] {
                    create_dir(&out_dir.join(folder))?;
                    copy_files(root, folder, out_dir, &mut written)?;
                }
                written.left_out.sort();
            }
        }
        let path = out_dir.join(&written.marked);
        fs::write(&path, marked).map_err(|source| io_error(&path, source))?;
        Ok(written)
    }
}

fn io_error(path: &Path, source: std::io::Error) -> EngineError {
    EngineError::Io { path: path.to_path_buf(), source }
}

fn create_dir(path: &Path) -> Result<(), EngineError> {
    fs::create_dir_all(path)
        .map_err(|source| EngineError::CannotCreate { path: path.to_path_buf(), reason: source.to_string() })
}

/// Names of a folder's entries, sorted.
fn list(folder: &Path) -> Result<Vec<PathBuf>, EngineError> {
    let entries = fs::read_dir(folder).map_err(|source| io_error(folder, source))?;
    let names = entries.map(|entry| entry.map(|entry| PathBuf::from(entry.file_name())));
    let mut names: Vec<PathBuf> = names.collect::<Result<_, _>>().map_err(|source| io_error(folder, source))?;
    names.sort();
    Ok(names)
}

/// `point_cloud/iteration_N` with the largest N, relative to `root`.
fn largest_iteration(root: &Path) -> Result<PathBuf, EngineError> {
    let folder = root.join(POINT_CLOUD);
    let missing = || EngineError::MissingInput {
        path: folder.join(format!("{ITERATION}N")).join(PLY_NAME),
        expected: "a 4DGaussians folder with a saved iteration".to_owned(),
    };
    if !folder.is_dir() {
        return Err(missing());
    }
    let names = list(&folder)?;
    let numbered = names.into_iter().filter_map(|name| {
        let number: u64 = name.to_str()?.strip_prefix(ITERATION)?.parse().ok()?;
        folder.join(&name).is_dir().then_some((number, name))
    });
    let (_, name) = numbered.max().ok_or_else(missing)?;
    Ok(Path::new(POINT_CLOUD).join(name))
}

fn check_degree(path: &Path, config: &DeformConfig, gaussians: &Gaussians) -> Result<(), EngineError> {
    if config.sh_degree == gaussians.sh_degree {
        return Ok(());
    }
    let expected = format!("{}, as {PLY_NAME} stores", gaussians.sh_degree);
    Err(bad_data(path, "sh_degree", config.sh_degree, expected))
}

/// Checks the shape of a training-only tensor, if its file is there: it tells a PLY of another run.
fn check_training_tensor(path: &Path, shape: &[usize]) -> Result<(), EngineError> {
    if !path.exists() {
        return Ok(());
    }
    let expected = format!("a tensor of shape {shape:?}, one row per splat of {PLY_NAME}");
    match PthContent::open(path)? {
        PthContent::Tensor(Tensor { shape: got, .. }) if got == shape => Ok(()),
        PthContent::Tensor(Tensor { shape: got, .. }) => Err(bad_data(path, "shape", format!("{got:?}"), expected)),
        PthContent::StateDict(_) => Err(bad_data(path, "root", "a state dict", expected)),
    }
}

fn holds_splats(name: &Path) -> bool {
    let extension = name.extension().map(|e| e.to_ascii_lowercase());
    let extension = extension.as_ref().and_then(|e| e.to_str());
    extension.is_some_and(|extension| SPLAT_EXTENSIONS.contains(&extension))
        || name.to_string_lossy().starts_with(CHECKPOINT)
}

/// Copies the regular files of `root/folder` that hold no splats.
fn copy_files(root: &Path, folder: &Path, out_dir: &Path, written: &mut Written) -> Result<(), EngineError> {
    for name in list(&root.join(folder))? {
        let relative = folder.join(&name);
        if relative == written.marked || written.marked.starts_with(&relative) {
            continue;
        }
        let source = root.join(&relative);
        if holds_splats(&name) || !source.is_file() {
            written.left_out.push(relative);
            continue;
        }
        fs::copy(&source, out_dir.join(&relative)).map_err(|error| io_error(&source, error))?;
        written.copied.push(relative);
    }
    Ok(())
}

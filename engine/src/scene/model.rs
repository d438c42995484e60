//! Models: splats, what moves them, and how a marked copy is written.

use std::fs;
use std::path::{Path, PathBuf};

use super::cfg_args::DeformConfig;
use super::deformation::{DeformationWeights, derive_config};
use super::folder::{has_splat_extension, list};
use super::gaussians::Gaussians;
use super::motion::Motion;
use super::sequence::{self, Take};
use super::source::{Opened, SplatSource};
use super::warp::{WarpWeights, has_white_background};
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;
use crate::scene::formats::KNOWN;
use crate::scene::ply::encode;
use crate::scene::pth::{PthContent, Tensor};

const CFG_ARGS: &str = "cfg_args";
/// Folder of a trainer's output that holds the splats.
pub(super) const POINT_CLOUD: &str = "point_cloud";
const ITERATION: &str = "iteration_";
const PLY_NAME: &str = "point_cloud.ply";
const DEFORMATION: &str = "deformation.pth";
/// Folder and file of a Deformable-3DGS network, which has an iteration of its own.
const DEFORM: &str = "deform";
const WARP: &str = "deform.pth";
const TABLE: &str = "deformation_table.pth";
const ACCUM: &str = "deformation_accum.pth";

const WHITE: [f32; 3] = [1.0; 3];
const BLACK: [f32; 3] = [0.0; 3];

/// Start of the names of training checkpoints, which hold the splats too.
const CHECKPOINT: &str = "chkpnt";

/// Logit of an opacity of half a step of 8 bits, 0.5/255: what is less is lost in any picture.
const LEAST_LOGIT: f32 = -6.232_448;

/// A model as loaded: splats, their motion, and the files they came from.
#[derive(Clone, Debug)]
pub struct Model {
    /// Canonical splats.
    pub gaussians: Gaussians,
    /// What moves them.
    pub motion: Motion,
    /// Background colour that the model was trained on.
    pub background: [f32; 3],
    /// What was assumed because the files do not say it, and what was left out; to be shown to the user.
    pub warnings: Vec<String>,
    /// One, or one for each moment of a sequence.
    sources: Vec<SplatSource>,
    layout: Layout,
}

/// The files of a model.
#[derive(Clone, Debug)]
enum Layout {
    /// A file on its own.
    Static,
    /// An output folder of a trainer and the folders below it that are in use, relative to it: that of point clouds,
    /// the iteration with the splats, and those of a network elsewhere.
    Folder { root: PathBuf, parts: Vec<PathBuf> },
    /// A folder with a file for each moment.
    Sequence { root: PathBuf },
}

/// What [`Model::write_marked`] did, with paths relative to the model.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The files that were written with new colours.
    pub marked: Vec<PathBuf>,
    /// Files that were copied byte for byte.
    pub copied: Vec<PathBuf>,
    /// Entries that stayed behind: other folders, and files with unmarked splats.
    pub left_out: Vec<PathBuf>,
}

impl Model {
    /// Loads a folder of 4DGaussians or Deformable-3DGS (its largest iterations), a folder with a file of splats for
    /// each moment, or one such file.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] and [`EngineError::Io`] naming the file, [`EngineError::BadData`] naming file and
    /// field when a file is malformed or the files of a folder contradict each other.
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() && !path.join(POINT_CLOUD).exists() => Self::open_sequence(path),
            Ok(metadata) if metadata.is_dir() => Self::open_folder(path),
            Ok(_) => Ok(Self::of_file(SplatSource::open(path)?)),
            Err(source) if source.kind() == std::io::ErrorKind::NotFound => {
                let expected = format!("a 4DGaussians folder, or splats as {KNOWN}");
                Err(EngineError::MissingInput { path: path.to_path_buf(), expected })
            }
            Err(source) => Err(io_error(path, source)),
        }
    }

    /// The same, but marked copies of a file whose format rounds colours (SPZ, SOG, compressed PLY, .splat) will be of
    /// that format, with rounded colours, and no PLYs. Of SOG, compressed PLY and .splat base colours alone change.
    ///
    /// # Errors
    /// As [`Model::open`].
    pub fn open_in_kind(path: &Path) -> Result<Self, EngineError> {
        if path.is_file() { Ok(Self::of_file(SplatSource::open_in_kind(path)?)) } else { Self::open(path) }
    }

    /// The model in `bytes`, the content of a single file at `path`.
    ///
    /// # Errors
    /// As [`Model::open`] for files.
    pub fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, EngineError> {
        Ok(Self::of_file(SplatSource::parse(path, bytes)?))
    }

    /// A static model that no file holds yet; `name` is what it is written as.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for splats that no file may hold, as when there are none.
    pub fn of_splats(name: &Path, gaussians: &Gaussians, background: [f32; 3]) -> Result<Self, EngineError> {
        Ok(Self { background, ..Self::parse(name, encode(gaussians))? })
    }

    fn of_file(opened: Opened) -> Self {
        let Opened { source, gaussians, trajectories, warnings } = opened;
        let motion = trajectories.map_or(Motion::Still, Motion::Paths);
        Self { gaussians, motion, background: BLACK, warnings, sources: vec![source], layout: Layout::Static }
    }

    fn open_sequence(root: &Path) -> Result<Self, EngineError> {
        let Take { moments, sources, warnings } = sequence::open(root)?;
        let gaussians = moments[0].clone();
        let motion = Motion::Sequence(moments);
        let layout = Layout::Sequence { root: root.to_path_buf() };
        Ok(Self { gaussians, motion, background: BLACK, warnings, sources, layout })
    }

    fn open_folder(root: &Path) -> Result<Self, EngineError> {
        let iteration = largest_iteration(root, POINT_CLOUD, PLY_NAME)?;
        let folder = root.join(&iteration);
        let opened = SplatSource::open(&folder.join(PLY_NAME))?;
        if opened.trajectories.is_some() {
            let expected = "splats that a network moves; open this file on its own";
            return Err(bad_data(&folder.join(PLY_NAME), "vertex", "splats on paths of their own", expected));
        }
        let Opened { source, gaussians, mut warnings, .. } = opened;
        if root.join(DEFORM).is_dir() {
            let warp = largest_iteration(root, DEFORM, WARP)?;
            let (weights, background) = open_warp(root, &warp)?;
            let motion = Motion::Warp(Box::new(weights));
            let layout = Layout::Folder {
                root: root.to_path_buf(),
                parts: vec![POINT_CLOUD.into(), iteration, DEFORM.into(), warp],
            };
            return Ok(Self { gaussians, motion, background, warnings, sources: vec![source], layout });
        }
        let rows = source.rows();
        let weights_path = folder.join(DEFORMATION);
        let expected = "the deformation network of a 4DGaussians folder (a static model is given as its .ply)";
        let bytes = read_file(&weights_path, expected)?;
        let PthContent::StateDict(tensors) = PthContent::parse(&weights_path, &bytes)? else {
            return Err(bad_data(&weights_path, "root", "a bare tensor", "a state dict"));
        };
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
        check_training_tensor(&folder.join(TABLE), &[rows])?;
        check_training_tensor(&folder.join(ACCUM), &[rows, 3])?;
        let background = if config.white_background { WHITE } else { BLACK };
        let deformation = DeformationWeights::from_state_dict(&weights_path, tensors, config)?;
        Ok(Self {
            gaussians,
            motion: Motion::HexPlane(Box::new(deformation)),
            background,
            warnings,
            sources: vec![source],
            layout: Layout::Folder { root: root.to_path_buf(), parts: vec![POINT_CLOUD.into(), iteration] },
        })
    }

    /// The files that hold the splats: one, or one for each moment of a sequence.
    #[must_use]
    pub fn sources(&self) -> &[SplatSource] {
        &self.sources
    }

    /// Whether the files hold plain colours instead of SH coefficients, so that an offset acts on RGB.
    #[must_use]
    pub fn is_rgb(&self) -> bool {
        self.sources.iter().any(SplatSource::is_rgb)
    }

    /// Whether the splat of row `row` is seen at any time from anywhere: no renderer draws what is less opaque than
    /// half a step of 8 bits. A network that changes opacities may bring up any.
    #[must_use]
    pub fn is_ever_drawn(&self, row: usize) -> bool {
        let is_drawn = |splats: &Gaussians| splats.opacities[row] >= LEAST_LOGIT;
        match &self.motion {
            Motion::HexPlane(weights) if !weights.config.no_do => true,
            Motion::Sequence(moments) => moments.iter().any(is_drawn),
            _ => is_drawn(&self.gaussians),
        }
    }

    /// Hash of the files that hold the splats: of the only one's bytes, or of the hashes of all.
    #[must_use]
    pub fn digest(&self) -> Digest {
        digest_of(self.sources.iter().map(SplatSource::bytes))
    }

    /// The same hash of the files with other colours.
    ///
    /// # Shapes
    /// in `words` as [`Model::words`]
    #[must_use]
    pub fn digest_with(&self, words: &[u32]) -> Digest {
        let files = self.with_words(words);
        digest_of(files.iter().map(Vec::as_slice))
    }

    /// The words that hold the colours of all files, one file behind the other.
    ///
    /// # Errors
    /// Those of [`SplatSource::words`].
    pub fn words(&self) -> Result<Vec<u32>, EngineError> {
        let words: Result<Vec<_>, _> = self.sources.iter().map(SplatSource::words).collect();
        Ok(words?.concat())
    }

    /// Whether new colours can be written into copies of the files.
    ///
    /// # Errors
    /// Those of [`SplatSource::words`], which say why not.
    pub fn check_writable(&self) -> Result<(), EngineError> {
        self.sources.iter().try_for_each(|source| source.num_words().map(|_| ()))
    }

    /// The words for other coefficients; what the moments of a sequence change by is the same for all.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[N,16,3\] coefficient-major
    ///
    /// # Errors
    /// Those of [`SplatSource::words_of`].
    pub fn words_of(&self, sh_coeffs: &[f32]) -> Result<Vec<u32>, EngineError> {
        let mut words = self.sources[0].words_of(sh_coeffs)?;
        if let Motion::Sequence(moments) = &self.motion {
            for (source, moment) in self.sources.iter().zip(moments).skip(1) {
                let first = sh_coeffs.iter().zip(&self.gaussians.sh_coeffs);
                let shifted: Vec<f32> =
                    first.zip(&moment.sh_coeffs).map(|((new, old), own)| own + (new - old)).collect();
                words.extend(source.words_of(&shifted)?);
            }
        }
        Ok(words)
    }

    /// The coefficients as a copy of the model will hold them: the same, unless its format keeps colours coarsely.
    ///
    /// # Shapes
    /// `sh_coeffs`, out \[N,16,3\] coefficient-major
    ///
    /// # Errors
    /// Those of [`SplatSource::words_of`].
    pub fn as_stored(&self, sh_coeffs: &[f32]) -> Result<Vec<f32>, EngineError> {
        let source = &self.sources[0];
        Ok(source.coeffs_of(&source.words_of(sh_coeffs)?))
    }

    /// The files with other colours, in the order of [`Model::sources`].
    ///
    /// # Shapes
    /// in `words` as [`Model::words`]
    #[must_use]
    pub fn with_words(&self, words: &[u32]) -> Vec<Vec<u8>> {
        let mut rest = words;
        let copy = |source: &SplatSource| {
            let (own, others) = rest.split_at(rest.len().min(source.num_words().unwrap_or_default()));
            rest = others;
            source.with_words(own)
        };
        self.sources.iter().map(copy).collect()
    }

    /// Writes a copy of the model with other SH coefficients into the folder `out_dir`, which may exist.
    ///
    /// The layout is kept and files with splats change only in the bytes of their colours. Files beside them and beside
    /// `cfg_args` are copied byte for byte, except those that hold splats themselves (other PLYs, checkpoints, other
    /// iterations): they are unmarked, and whoever receives the copy must not find them in it.
    ///
    /// # Shapes
    /// in `sh_coeffs` \[N,16,3\] coefficient-major
    ///
    /// # Errors
    /// Those of [`SplatSource::words_of`]; [`EngineError::Io`] naming the file that could not be read or written.
    pub fn write_marked(&self, out_dir: &Path, sh_coeffs: &[f32]) -> Result<Written, EngineError> {
        self.write(out_dir, &self.words_of(sh_coeffs)?)
    }

    /// Writes a copy of the model with other words for its colours, as [`Model::write_marked`] does.
    ///
    /// # Errors
    /// [`EngineError::Io`] naming the file that could not be read or written.
    pub fn write(&self, out_dir: &Path, words: &[u32]) -> Result<Written, EngineError> {
        let mut written = Written::default();
        let name = |source: &SplatSource| source.path().file_name().map_or_else(|| PLY_NAME.into(), PathBuf::from);
        create_dir(out_dir)?;
        match &self.layout {
            Layout::Static => written.marked = self.sources.iter().map(name).collect(),
            Layout::Sequence { root } => {
                written.marked = self.sources.iter().map(name).collect();
                copy_files(root, Path::new(""), &[], out_dir, &mut written)?;
            }
            Layout::Folder { root, parts } => {
                written.marked = vec![parts[1].join(PLY_NAME)];
                for folder in std::iter::once(Path::new("")).chain(parts.iter().map(PathBuf::as_path)) {
                    create_dir(&out_dir.join(folder))?;
                    copy_files(root, folder, parts, out_dir, &mut written)?;
                }
                written.left_out.sort();
            }
        }
        for (relative, bytes) in written.marked.iter().zip(self.with_words(words)) {
            let path = out_dir.join(relative);
            fs::write(&path, bytes).map_err(|source| io_error(&path, source))?;
        }
        Ok(written)
    }
}

fn digest_of<'a>(files: impl Iterator<Item = &'a [u8]>) -> Digest {
    let mut hashes: Vec<Digest> = files.map(Digest::of).collect();
    match hashes.len() {
        1 => hashes.remove(0),
        _ => Digest::of(hashes.iter().map(Digest::to_string).collect::<String>().as_bytes()),
    }
}

fn io_error(path: &Path, source: std::io::Error) -> EngineError {
    EngineError::Io { path: path.to_path_buf(), source }
}

fn create_dir(path: &Path) -> Result<(), EngineError> {
    fs::create_dir_all(path)
        .map_err(|source| EngineError::CannotCreate { path: path.to_path_buf(), reason: source.to_string() })
}

/// `PARENT/iteration_N` with the largest N, relative to `root`; `file` is what it should hold.
fn largest_iteration(root: &Path, parent: &str, file: &str) -> Result<PathBuf, EngineError> {
    let folder = root.join(parent);
    let missing = || EngineError::MissingInput {
        path: folder.join(format!("{ITERATION}N")).join(file),
        expected: "a trainer's folder with a saved iteration".to_owned(),
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
    Ok(Path::new(parent).join(name))
}

/// The network of a Deformable-3DGS folder in its iteration `warp`, and the background that it was trained on.
fn open_warp(root: &Path, warp: &Path) -> Result<(WarpWeights, [f32; 3]), EngineError> {
    let path = root.join(warp).join(WARP);
    let PthContent::StateDict(tensors) = PthContent::open(&path)? else {
        return Err(bad_data(&path, "root", "a bare tensor", "a state dict"));
    };
    let weights = WarpWeights::from_state_dict(&path, tensors)?;
    let cfg_path = root.join(CFG_ARGS);
    let is_white = cfg_path.exists() && has_white_background(&cfg_path, &read_file(&cfg_path, "cfg_args")?)?;
    Ok((weights, if is_white { WHITE } else { BLACK }))
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
    has_splat_extension(name) || name.to_string_lossy().starts_with(CHECKPOINT)
}

/// Copies the regular files of `root/folder` that hold no splats.
fn copy_files(
    root: &Path,
    folder: &Path,
    used: &[PathBuf],
    out_dir: &Path,
    written: &mut Written,
) -> Result<(), EngineError> {
    for name in list(&root.join(folder))? {
        let relative = folder.join(&name);
        if written.marked.contains(&relative) || used.contains(&relative) {
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

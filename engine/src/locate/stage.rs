//! The unmarked asset, drawn small and often.

use std::sync::Arc;

use glam::DVec3;
use guard4d_kernels::splat::rules::{Opacity, Rules};
use guard4d_kernels::{Buffer, Device};

use super::gray::Gray;
use super::merged::merged;
use super::pose::{Middle, Pose};
use super::thumbnail::Thumbnail;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::render::deform::{DeformField, MixedField, SplatState};
use crate::render::making::Making;
use crate::render::profile::Viewer;
use crate::render::settings::Settings;
use crate::render::{FrameMut, FramePlan, OffsetBases, Offsets, Prune, Renderer};
use crate::scene::camera::paths::USUAL_FOV_X_RAD;
use crate::scene::gaussians::{SH_FLOATS, Y0};
use crate::scene::{FrameSize, LookAt, Model, Motion};

/// Small pictures are drawn so many times as large along a side, and made smaller.
const FINER: u32 = 2;
/// How small pictures are drawn: splats are widened by what a pixel spreads them (a square's variance), and are as much
/// less opaque. A film's pixel is little to them; in small pictures those that grow as opaque as they are hide
/// everything.
const SMALL: Rules = Rules { dilation: 1.0 / 12.0, opacity: Opacity::Compensated, ..Rules::REFERENCE };
/// Radius of the scene, px of the smallest pictures, up to which splats that share a pixel are one.
pub const MERGED_PX: f64 = 32.0;
/// Side of the picture that says how far away what is seen is, px.
const LOOK_PX: u32 = 16;
/// How far places are told apart, in radii of what a usual camera takes in: what is farther is a scene's sky, and
/// numbers of 32 bits tell places to a millionth of that.
const FAR: f64 = 16.0;

/// Least share of a pixel that the asset covers to be seen there.
const COVERED: f64 = 0.1;
/// How far beside the asset its outline is looked for.
const OUTLINE_PX: usize = 2;

/// Whether the asset is seen in a pixel of which so much is clear.
#[must_use]
pub fn is_seen(clear: f32) -> bool {
    f64::from(1.0 - clear) >= COVERED
}

/// What poses are about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum About {
    /// The asset's middle, which is before all cameras.
    Middle,
    /// What each camera sees: they stand within the scene, and its middle may be behind them.
    Seen,
}

/// The asset as a renderer has it.
#[derive(Debug)]
struct Scenery {
    settings: Settings,
    field: MixedField,
    renderer: Renderer,
}

impl Scenery {
    fn new(device: &Device, model: &Model, settings: Settings) -> Result<Self, EngineError> {
        let profile = settings.profile();
        let field = MixedField::new(device, profile.upload(device, &model.gaussians, &model.motion)?);
        Ok(Self { settings, field, renderer: Renderer::new(device)?.with_rules(profile.rules) })
    }

    /// The same splats at other settings that keep them.
    fn at(self, settings: Settings) -> Self {
        Self { settings, renderer: self.renderer.with_rules(settings.profile().rules), ..self }
    }
}

/// The asset with what draws it.
#[derive(Debug)]
pub struct Stage {
    device: Device,
    /// The asset of fewer splats, for the smallest pictures. A scene whose splats move each its own way has none, as to
    /// merge it at every moment takes longer than its pictures; nor has one that is seen from within, where splats are
    /// of all sizes.
    merged_field: Option<MixedField>,
    /// What small pictures are drawn by.
    small: Renderer,
    /// The asset as it is.
    own: Scenery,
    /// Whose renderer drew the film, where that is another.
    others: Option<Scenery>,
    making: Making,
    background: [f32; 3],
    look_at: LookAt,
    about: About,
    moves: bool,
    places: Places,
    /// The plan that was made last: places are asked for where a picture was drawn.
    planned: Option<(MadeFor, Arc<FramePlan>)>,
    /// Offsets with which the colours of a moment are places, of the moment that was asked last.
    as_places: Option<(Arc<SplatState>, Buffer<f32>)>,
}

impl Stage {
    /// Of an asset.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn new(device: &Device, model: &Model, about: About) -> Result<Self, EngineError> {
        let look_at = LookAt::of(model, USUAL_FOV_X_RAD);
        let middle = middle(look_at);
        let places = Places::about(middle);
        let merged_field = match (&model.motion, about) {
            // What moves them is of places, and those of splats that are one are all but the same.
            (Motion::Still | Motion::HexPlane(_) | Motion::Warp(_), About::Middle) => {
                let fewer = merged(&model.gaussians, middle.radius / MERGED_PX);
                Some(MixedField::new(device, DeformField::new(device, &fewer, &model.motion)?))
            }
            _ => None,
        };
        Ok(Self {
            device: device.clone(),
            merged_field,
            small: Renderer::new(device)?.with_rules(SMALL),
            own: Scenery::new(device, model, Viewer::Reference.into())?,
            others: None,
            making: Making::default(),
            background: model.background,
            look_at,
            about,
            moves: !model.motion.is_still(),
            places,
            planned: None,
            as_places: None,
        })
    }

    /// What usual cameras look at.
    #[must_use]
    pub fn look_at(&self) -> LookAt {
        self.look_at
    }

    /// The middle, with as much about it as a usual camera takes in.
    #[must_use]
    pub fn middle(&self) -> Middle {
        middle(self.look_at)
    }

    /// What poses are about.
    #[must_use]
    pub fn about(&self) -> About {
        self.about
    }

    /// The same view about what is before its camera now, if that is what poses are about.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn about_what_is_seen(&mut self, pose: &Pose) -> Result<Pose, EngineError> {
        self.about_what_is_seen_in(Canvas::small(FrameSize::new(LOOK_PX, LOOK_PX)?), pose)
    }

    /// The same by a picture that was drawn from there, or will be: most of what pictures take is what is alike in
    /// both.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn about_what_is_seen_in(&mut self, canvas: Canvas, pose: &Pose) -> Result<Pose, EngineError> {
        if self.about == About::Middle {
            return Ok(*pose);
        }
        let points = self.points(pose, canvas)?;
        let depths = points.into_iter().flatten().map(|point| pose.depth_of(point)).filter(|depth| *depth > 0.0);
        let mut depths: Vec<f64> = depths.collect();
        depths.sort_by(f64::total_cmp);
        Ok(depths.get(depths.len() / 2).map_or(*pose, |depth| pose.about_depth(*depth)))
    }

    /// Whether time changes anything.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.moves
    }

    /// The asset at a moment.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn at(&mut self, time: f64) -> Result<Arc<SplatState>, EngineError> {
        self.own.field.at(time)
    }

    /// Even steps from the first moment to the last: moments at their ends are the cheapest.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.own.field.steps()
    }

    /// How the asset is drawn from now on where it is drawn as the film was; `model` is the same asset.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn draw_as(&mut self, model: &Model, making: Making) -> Result<(), EngineError> {
        let settings = making.settings;
        let has = |scenery: &Scenery| scenery.settings == settings;
        if !has(&self.own) && !self.others.as_ref().is_some_and(has) {
            self.others = Some(match self.others.take() {
                Some(others) if others.settings.keeps_splats_of(&settings) => others.at(settings),
                _ => Scenery::new(&self.device, model, settings)?,
            });
        }
        self.making = making;
        Ok(())
    }

    /// See [`Self::draw_as`].
    #[must_use]
    pub fn making(&self) -> Making {
        self.making
    }

    /// What draws pictures that show this.
    fn renderer(&mut self, shows: Shows) -> &mut Renderer {
        let settings = self.making.settings;
        match (shows, &mut self.others) {
            (Shows::AsFilm(_), Some(others)) if others.settings == settings => &mut others.renderer,
            (Shows::AsFilm(_), _) => &mut self.own.renderer,
            (Shows::Small | Shows::Smallest, _) => &mut self.small,
        }
    }

    /// The asset at a moment, as that draws it.
    fn splats(&mut self, time: f64, shows: Shows) -> Result<Arc<SplatState>, EngineError> {
        let settings = self.making.settings;
        match (shows, &mut self.others, &mut self.merged_field) {
            (Shows::AsFilm(_), Some(others), _) if others.settings == settings => others.field.at(time),
            (Shows::Smallest, _, Some(merged)) => merged.at(time),
            _ => self.at(time),
        }
    }

    fn drawn_at(&self, canvas: Canvas) -> Result<FrameSize, EngineError> {
        let (size, times) = match canvas.shows {
            Shows::AsFilm(film) => (film, self.making.times),
            Shows::Small | Shows::Smallest => (canvas.size, FINER),
        };
        FrameSize::new(times * size.width(), times * size.height())
    }

    /// What a camera sees of the asset at the pose's moment.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn draw(&mut self, pose: &Pose, canvas: Canvas) -> Result<Drawn, EngineError> {
        Ok(self.draw_pixels(pose, canvas)?.drawn())
    }

    /// The same before it is made smaller, and in colour.
    ///
    /// # Errors
    /// As [`draw`](Self::draw).
    pub fn draw_pixels(&mut self, pose: &Pose, canvas: Canvas) -> Result<Pixels, EngineError> {
        let plan = self.plan(pose, canvas)?;
        let mut rec = self.device.recorder()?;
        let mut pixels = self.device.buffer("locate.frame", plan.frame_len())?;
        let (background, frame) = (self.background, FrameMut { clip: &mut pixels, index: 0 });
        self.renderer(canvas.shows).forward_linear(&mut rec, &plan, None, background, frame)?;
        rec.submit()?;
        Ok(Pixels { values: pixels.read()?, drawn: self.drawn_at(canvas)?, size: canvas.size })
    }

    /// For each pixel of the same picture the point that it shows, where it shows enough of the asset.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn points(&mut self, pose: &Pose, canvas: Canvas) -> Result<Vec<Option<DVec3>>, EngineError> {
        let (drawn_at, size) = (self.drawn_at(canvas)?, canvas.size);
        let plan = self.plan(pose, canvas)?;
        let state = self.splats(pose.time, canvas.shows)?;
        let as_places = match self.as_places.take() {
            Some(known) if Arc::ptr_eq(&known.0, &state) => known,
            _ => {
                let offsets = self.places.offsets(&state.raw().means.read()?, &state.sh_coeffs().read()?);
                (state, self.device.buffer_from("locate.as_places", &offsets)?)
            }
        };
        let mut rec = self.device.recorder()?;
        let mut places = self.device.buffer("locate.places", plan.frame_len())?;
        let offsets = Some(Offsets { data: &as_places.1, bases: OffsetBases::All });
        let frame = FrameMut { clip: &mut places, index: 0 };
        self.renderer(canvas.shows).forward_linear(&mut rec, &plan, offsets, [0.0; 3], frame)?;
        rec.submit()?;
        self.as_places = Some(as_places);
        // Sums where several drawn pixels are one of the picture, which are as many for all but at the borders.
        let (across, width) = (drawn_at.width() as usize, size.width() as usize);
        let [x_of, y_of] = [(drawn_at.width(), size.width()), (drawn_at.height(), size.height())]
            .map(|(from, to)| move |at: usize| at * to as usize / from as usize);
        let mut sums = vec![[0.0f64; 4]; width * size.height() as usize];
        for (at, pixel) in places.read()?.chunks_exact(4).enumerate() {
            let covered = 1.0 - f64::from(pixel[3]);
            let place = [pixel[0], pixel[1], pixel[2]].map(f64::from);
            let sums = &mut sums[y_of(at / across) * width + x_of(at % across)];
            sums.iter_mut().zip(place.into_iter().chain([covered])).for_each(|(sum, value)| *sum += value);
        }
        let area = |size: FrameSize| f64::from(size.width()) * f64::from(size.height());
        let enough = COVERED * area(drawn_at) / area(size);
        let point = |[x, y, z, covered]: [f64; 4]| {
            (covered >= enough).then(|| self.places.point(DVec3::new(x, y, z) / covered))
        };
        Ok(sums.into_iter().map(point).collect())
    }

    fn plan(&mut self, pose: &Pose, canvas: Canvas) -> Result<Arc<FramePlan>, EngineError> {
        let made_for = MadeFor { pose: *pose, canvas, making: self.making };
        if let Some((_, plan)) = self.planned.as_ref().filter(|(known, _)| *known == made_for) {
            return Ok(Arc::clone(plan));
        }
        let state = self.splats(pose.time, canvas.shows)?;
        let camera = pose.camera(self.drawn_at(canvas)?);
        let plan = Arc::new(self.renderer(canvas.shows).plan(&state, &camera, Prune::Keep)?);
        self.planned = Some((made_for, Arc::clone(&plan)));
        Ok(plan)
    }
}

/// What a plan was made for.
#[derive(Debug, PartialEq)]
struct MadeFor {
    pose: Pose,
    canvas: Canvas,
    making: Making,
}

fn middle(look_at: LookAt) -> Middle {
    Middle { point: look_at.target, radius: look_at.radius * (USUAL_FOV_X_RAD / 2.0).tan() }
}

/// How a picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Canvas {
    /// How large it is.
    pub size: FrameSize,
    /// What of the asset is in it.
    pub shows: Shows,
}

/// What of the asset is in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shows {
    /// What a film of this size would show, drawn as the film was made.
    AsFilm(FrameSize),
    /// The splats, in small.
    Small,
    /// The same, so small that splats that share a pixel are one: the scene's radius is no more than [`MERGED_PX`].
    Smallest,
}

impl Canvas {
    /// See [`Shows::AsFilm`].
    #[must_use]
    pub fn as_film(size: FrameSize, film: FrameSize) -> Self {
        Self { size, shows: Shows::AsFilm(film) }
    }

    /// See [`Shows::Small`].
    #[must_use]
    pub fn small(size: FrameSize) -> Self {
        Self { size, shows: Shows::Small }
    }

    /// See [`Shows::Smallest`].
    #[must_use]
    pub fn smallest(size: FrameSize) -> Self {
        Self { size, shows: Shows::Smallest }
    }
}

/// A picture of the asset as it was drawn, and the size at which it is wanted.
#[derive(Clone, Debug)]
pub struct Pixels {
    values: Vec<f32>,
    drawn: FrameSize,
    size: FrameSize,
}

impl Pixels {
    /// What is compared.
    #[must_use]
    pub fn drawn(&self) -> Drawn {
        let picture = Gray::of_pixels(self.drawn.width() as usize, self.drawn.height() as usize, &self.values);
        Drawn { picture: self.as_wanted(&picture), clear: self.clear() }
    }

    /// How much of the background is seen, 0 to 1.
    #[must_use]
    pub fn clear(&self) -> Gray {
        let values = self.values.chunks_exact(4).map(|rgba| rgba[3]).collect();
        self.as_wanted(&Gray { width: self.drawn.width() as usize, height: self.drawn.height() as usize, values })
    }

    fn as_wanted(&self, picture: &Gray) -> Gray {
        picture.resized(self.size.width() as usize, self.size.height() as usize)
    }

    /// The same in colour.
    #[must_use]
    pub fn thumbnail(&self) -> Thumbnail {
        let [drawn, size] = [self.drawn, self.size].map(|size| [size.width() as usize, size.height() as usize]);
        Thumbnail::of_pixels(drawn, &self.values, size)
    }
}

/// A picture of the asset.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Over the asset's own background.
    pub picture: Gray,
    /// How much of that is seen, 0 to 1.
    pub clear: Gray,
}

impl Drawn {
    /// Which pixels are of the asset and of its outline.
    #[must_use]
    pub fn outlined(&self) -> Vec<bool> {
        self.clear.least_within(OUTLINE_PX).values.into_iter().map(is_seen).collect()
    }
}

/// How places are kept as colours: between these, from 0 to 1.
#[derive(Clone, Copy, Debug)]
struct Places {
    low: DVec3,
    extent: DVec3,
}

impl Places {
    fn about(middle: Middle) -> Self {
        let half = DVec3::splat(FAR * middle.radius);
        Self { low: middle.point - half, extent: 2.0 * half }
    }

    fn colour(&self, place: DVec3) -> DVec3 {
        ((place - self.low) / self.extent).clamp(DVec3::ZERO, DVec3::ONE)
    }

    fn point(&self, colour: DVec3) -> DVec3 {
        self.low + colour * self.extent
    }

    /// Offsets of all coefficients `[N, 16, 3]` that make the colour of each of these splats its place, which is the
    /// first three of four numbers.
    fn offsets(&self, means: &[f32], sh_coeffs: &[f32]) -> Vec<f32> {
        let mut offsets: Vec<f32> = sh_coeffs.iter().map(|h| -h).collect();
        for (row, mean) in offsets.chunks_exact_mut(SH_FLOATS).zip(means.chunks_exact(4)) {
            let colour = self.colour(glam::Vec3::from_slice(mean).as_dvec3()).to_array();
            row.iter_mut().zip(colour).for_each(|(dc, colour)| *dc += narrow((colour - 0.5) / Y0));
        }
        offsets
    }
}

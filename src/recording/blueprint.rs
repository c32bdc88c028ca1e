//! The layout stored in the recording: large top views above, plots below, verdict and decisions at the side.
//!
//! Rerun's blueprint API cannot set the region of a 2D view or the axes of a plot. Therefore this module writes the
//! blueprint archetypes as the viewer reads them: `viewport`, `container/ID`, `view/ID`, `view/ID/PROPERTY`.

use rerun::datatypes::{Range2D, Uuid};
use rerun::external::re_log_types::{BlueprintActivationCommand, LogMsg};
use rerun::external::re_sdk_types::blueprint::archetypes as bp;
use rerun::external::re_sdk_types::blueprint::components::{
    ActiveTab, BackgroundKind, ColumnShare, ContainerKind, Corner2D, IncludedContent, LinkAxis, PanelState,
    QueryExpression, RootContainer, RowShare, TimelineName, VisualBounds2D,
};
use rerun::external::re_sdk_types::blueprint::datatypes::{TextLogColumn, TextLogColumnKind};
use rerun::{AsComponents, RecordingStream, RecordingStreamBuilder};

use super::series::{self, StationTime};
use super::style::GROUND;
use super::{APPLICATION, Context, RecordingError, TIMELINE};

/// Half-size of the view that follows the vehicle, m.
const FOLLOW_HALF_SIZE: (f64, f64) = (45.0, 14.0);
/// Extent of the action above which the view that follows the vehicle opens first, m.
const LONG_ACTION: f64 = 220.0;

/// Sends the layout for a run.
pub(super) fn send(context: &Context, recording_id: &str) -> Result<(), RecordingError> {
    let (stream, storage) = RecordingStreamBuilder::new(APPLICATION)
        .enabled(true)
        .recording_id(format!("layout-{recording_id}"))
        .blueprint()
        .memory()
        .map_err(RecordingError::encoding)?;
    stream.set_time_sequence("blueprint", 0);
    let mut layout = Layout { stream, count: 0 };
    let root = layout.all(context)?;
    layout.log("viewport", &bp::ViewportBlueprint::new().with_root_container(root.root()))?;
    layout.panels()?;
    let messages = storage.take();
    let blueprint_id = messages.iter().find_map(|message| match message {
        LogMsg::SetStoreInfo(info) => Some(info.info.store_id.clone()),
        _ => None,
    });
    if let Some(blueprint_id) = blueprint_id {
        let activation = BlueprintActivationCommand { blueprint_id, make_active: true, make_default: true };
        context.stream.send_blueprint(messages, activation);
    }
    Ok(())
}

/// A written view or container.
#[derive(Debug, Clone, Copy)]
struct Placed {
    kind: &'static str,
    number: u8,
}

impl Placed {
    fn uuid(self) -> [u8; 16] {
        // an arbitrary value, equal in every recording
        let mut bytes = *b"stopline-layout\0";
        bytes[15] = self.number;
        bytes
    }

    fn path(self) -> String {
        let digits: String = self.uuid().iter().map(|byte| format!("{byte:02x}")).collect();
        let groups = [&digits[..8], &digits[8..12], &digits[12..16], &digits[16..20], &digits[20..]];
        format!("{}/{}", self.kind, groups.join("-"))
    }

    fn root(self) -> RootContainer {
        RootContainer(Uuid { bytes: self.uuid() })
    }
}

/// A layout under construction.
struct Layout {
    stream: RecordingStream,
    count: u8,
}

impl Layout {
    fn log(&self, path: &str, data: &impl AsComponents) -> Result<(), RecordingError> {
        self.stream.log(path, data).map_err(RecordingError::encoding)
    }

    fn next(&mut self, kind: &'static str) -> Placed {
        self.count += 1;
        Placed { kind, number: self.count }
    }

    fn all(&mut self, context: &Context) -> Result<Placed, RecordingError> {
        let overview = self.top_view("Overview", "/", overview_bounds(context))?;
        let followed = (([-FOLLOW_HALF_SIZE.0, FOLLOW_HALF_SIZE.0]), ([-FOLLOW_HALF_SIZE.1, FOLLOW_HALF_SIZE.1]));
        let follow = self.top_view("Follow vehicle", "follow", followed)?;
        let long = context.action.width().max(context.action.height()) > LONG_ACTION;
        let top = self.tabs(&[overview, follow], if long { follow } else { overview })?;
        let names =
            ["Speed, m/s", "Acceleration, m/s²", "Jerk, m/s³", "Lateral acceleration, m/s²", "Steering, degrees"];
        let mut plots = Vec::new();
        for (name, (entity, range)) in names.into_iter().zip(series::ranges(context)) {
            plots.push(self.plot(name, entity, range)?);
        }
        let reach = StationTime::of(&context.run.cycles);
        let station_time = self.flat_view("Station over time", "st", &["+ $origin/**"], reach.view())?;
        plots.push(station_time);
        let (first, second) = plots.split_at(3);
        let upper = self.row(first, &[1.0, 1.0, 1.0])?;
        let lower = self.row(second, &[1.0, 1.0, 1.0])?;
        let aspect = context.action.width() / context.action.height();
        // a long, narrow road needs less height
        let share = if aspect > 4.0 { 1.3 } else { 2.2 };
        let main = self.column(&[top, upper, lower], &[share, 1.0, 1.0])?;
        let verdict = self.view("TextDocument", "Verdict", "verdict", &["+ $origin"])?;
        let decisions = self.text_log("Decisions", "decisions")?;
        let side = self.column(&[verdict, decisions], &[1.3, 1.0])?;
        self.row(&[main, side], &[3.2, 1.0])
    }

    fn view(&mut self, class: &str, name: &str, origin: &str, query: &[&str]) -> Result<Placed, RecordingError> {
        let view = self.next("view");
        let queries = query.iter().map(|q| QueryExpression((*q).into()));
        self.log(&format!("{}/ViewContents", view.path()), &bp::ViewContents::new(queries))?;
        let blueprint = bp::ViewBlueprint::new(class).with_display_name(name).with_space_origin(origin);
        self.log(&view.path(), &blueprint)?;
        Ok(view)
    }

    fn top_view(&mut self, name: &str, origin: &str, bounds: ([f64; 2], [f64; 2])) -> Result<Placed, RecordingError> {
        self.flat_view(name, origin, &["+ /map/**"], bounds)
    }

    fn flat_view(
        &mut self,
        name: &str,
        origin: &str,
        query: &[&str],
        (x, y): ([f64; 2], [f64; 2]),
    ) -> Result<Placed, RecordingError> {
        let view = self.view("2D", name, origin, query)?;
        let range = |ends: [f64; 2]| ends.into();
        let bounds = VisualBounds2D(Range2D { x_range: range(x), y_range: range(y) });
        self.log(&format!("{}/VisualBounds2D", view.path()), &bp::VisualBounds2D::new(bounds))?;
        let ground = bp::Background::new(BackgroundKind::SolidColor).with_color(GROUND);
        self.log(&format!("{}/Background", view.path()), &ground)?;
        Ok(view)
    }

    fn text_log(&mut self, name: &str, origin: &str) -> Result<Placed, RecordingError> {
        let view = self.view("TextLog", name, origin, &["+ $origin/**"])?;
        let column = |kind| TextLogColumn { visible: true.into(), kind };
        let columns = [TextLogColumnKind::LogLevel, TextLogColumnKind::Body].map(column);
        let columns = bp::TextLogColumns::new().with_text_log_columns(columns);
        self.log(&format!("{}/TextLogColumns", view.path()), &columns)?;
        Ok(view)
    }

    fn plot(&mut self, name: &str, entity: &str, range: [f64; 2]) -> Result<Placed, RecordingError> {
        let view = self.view("TimeSeries", name, &format!("series/{entity}"), &["+ $origin/**"])?;
        let axis = bp::TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
        self.log(&format!("{}/TimeAxis", view.path()), &axis)?;
        let values = bp::ScalarAxis::new().with_range(rerun::datatypes::Range1D(range));
        self.log(&format!("{}/ScalarAxis", view.path()), &values)?;
        // one legend for all plots: equal colours have equal meanings
        let legend = bp::PlotLegend::new().with_corner(Corner2D::RightTop).with_visible(entity == "speed");
        self.log(&format!("{}/PlotLegend", view.path()), &legend)?;
        Ok(view)
    }

    fn container(
        &mut self,
        kind: ContainerKind,
        contents: &[Placed],
        with: impl FnOnce(bp::ContainerBlueprint) -> bp::ContainerBlueprint,
    ) -> Result<Placed, RecordingError> {
        let container = self.next("container");
        let included = contents.iter().map(|c| IncludedContent(c.path().into()));
        self.log(&container.path(), &with(bp::ContainerBlueprint::new(kind).with_contents(included)))?;
        Ok(container)
    }

    fn row(&mut self, contents: &[Placed], shares: &[f32]) -> Result<Placed, RecordingError> {
        let shares = shares.iter().map(|s| ColumnShare((*s).into()));
        self.container(ContainerKind::Horizontal, contents, |c| c.with_col_shares(shares))
    }

    fn column(&mut self, contents: &[Placed], shares: &[f32]) -> Result<Placed, RecordingError> {
        let shares = shares.iter().map(|s| RowShare((*s).into()));
        self.container(ContainerKind::Vertical, contents, |c| c.with_row_shares(shares))
    }

    fn tabs(&mut self, contents: &[Placed], active: Placed) -> Result<Placed, RecordingError> {
        let active = ActiveTab(active.path().into());
        self.container(ContainerKind::Tabs, contents, |c| c.with_active_tab(active))
    }

    /// Hides the viewer's panels and selects our timeline.
    fn panels(&self) -> Result<(), RecordingError> {
        let folded = |state| bp::PanelBlueprint::new().with_state(state);
        self.log("blueprint_panel", &folded(PanelState::Hidden))?;
        self.log("selection_panel", &folded(PanelState::Hidden))?;
        let time = bp::TimePanelBlueprint::new().with_state(PanelState::Collapsed);
        let timeline = TimelineName(TIMELINE.into());
        self.log("time_panel", &time.with_timeline(timeline))
    }
}

/// The bounds of the action in viewer coordinates: y down.
fn overview_bounds(context: &Context) -> ([f64; 2], [f64; 2]) {
    let (min, max) = (context.action.min - context.origin, context.action.max - context.origin);
    ([min.x, max.x], [-max.y, -min.y])
}

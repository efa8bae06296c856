from usbldr.io.findings import Finding as Finding
from usbldr.io.geodesy import Origin as Origin
from usbldr.io.log import Log as Log
from usbldr.io.messages.layouts import MessageLayout as MessageLayout
from usbldr.io.provenance import Convention as Convention
from usbldr.io.provenance import Provenance as Provenance
from usbldr.io.reader import Reader as Reader
from usbldr.io.reader import Records as Records
from usbldr.io.reader import TopicInfo as TopicInfo
from usbldr.io.reading.epochs import timeline as timeline
from usbldr.io.reading.opening import Request as Request
from usbldr.io.reports.python_runs import to_frame as to_frame
from usbldr.io.reports.python_runs import write_run as write_run
from usbldr.io.reports.run import ScoredTrack as ScoredTrack
from usbldr.io.session import RunSettings as RunSettings
from usbldr.io.session import bound as bound
from usbldr.io.session import evaluate as evaluate
from usbldr.io.session import open_log as open_log
from usbldr.io.session import reference_tracks as reference_tracks
from usbldr.io.session import replay as replay
from usbldr.io.session import resolve as resolve
from usbldr.io.session import score as score

__all__: list[str]

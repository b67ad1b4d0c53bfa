# The public names of `calibrate`, and where each is defined.

from .core.errors import CalibrationError as CalibrationError
from .core.errors import InputError as InputError
from .io.lab import Lab as Lab
from .io.lab import bundled_lab as bundled_lab
from .io.lab import load_lab as load_lab
from .verbs.audit import AuditResult as AuditResult
from .verbs.audit import audit as audit
from .verbs.check import check as check
from .verbs.contact import ContactResult as ContactResult
from .verbs.contact import contact as contact
from .verbs.convert import ConvertResult as ConvertResult
from .verbs.convert import convert as convert
from .verbs.diagnose import DiagnosisResult as DiagnosisResult
from .verbs.diagnose import diagnose as diagnose
from .verbs.doe import DoeResult as DoeResult
from .verbs.doe import doe as doe
from .verbs.export import ExportResult as ExportResult
from .verbs.export import export as export
from .verbs.fit import FitResult as FitResult
from .verbs.fit import fit as fit
from .verbs.next import NextTestResult as NextTestResult
from .verbs.next import next_test as next_test
from .verbs.report import ReportResult as ReportResult
from .verbs.report import report as report
from .verbs.simulate import SimulationResult as SimulationResult
from .verbs.simulate import simulate as simulate

"""What a log tells afterwards: the run as data, tables and HDF5 for other programs, and a page for people."""

from defgrasp_ros.analysis.recorded_run import RecordedGrasp, RecordedRun, TimeSeries, load_run

__all__ = ["RecordedGrasp", "RecordedRun", "TimeSeries", "load_run"]

"""``defgrasp replay``: publishes a log again."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn

from defgrasp_ros.commands.key_press import on_key
from defgrasp_ros.commands.log_argument import LogArgument
from defgrasp_ros.errors import InvalidOptionsError

NODE_NAME = "defgrasp_replay"


def replay(
    log: LogArgument,
    rate: Annotated[float, typer.Option(help="Factor on the speed [-]")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end, until Ctrl-C")] = False,
    start: Annotated[float, typer.Option(help="Where to begin, from the beginning of the log [s]")] = 0.0,
    topics: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="What is published, with commas: status,evaluations; default: everything"),
    ] = None,
    clock: Annotated[bool, typer.Option("--clock", help="Publish the log time on /clock, too")] = False,
    pause: Annotated[bool, typer.Option("--pause", help="Begin paused; the space bar goes on, and pauses")] = False,
    wait: Annotated[
        float, typer.Option(help="How long to look for the first subscriber before the first message, at most [s]")
    ] = 4.0,
) -> None:
    """Publish the messages of LOG again: same topics, same quality of service, same rhythm.

    The space bar pauses and goes on. Needs ROS 2, but not its command line tools.
    """
    if not rate > 0.0:
        raise InvalidOptionsError(f"--rate = {rate:g} is not above 0")
    if not wait >= 0.0:
        raise InvalidOptionsError(f"--wait = {wait:g} s is not 0 or more")
    if pause and not sys.stdin.isatty():
        raise InvalidOptionsError("--pause needs a terminal, whose space bar lets the replay go on")

    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from defgrasp_ros.recording.topic import NANOSECONDS
    from defgrasp_ros.ros.playback_timer import PlaybackTimer
    from defgrasp_ros.ros.player import Player, log_time_at

    console = Console(stderr=True)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(NODE_NAME, start_parameter_services=False, enable_rosout=False)
    try:
        player = Player(node, log, [name.strip() for name in topics.split(",")] if topics else (), with_clock=clock)
        for reason in player.left_out:
            console.print(f"[yellow]left out[/] {escape(reason)}", highlight=False, soft_wrap=True)
        summary = player.summary
        begin = log_time_at(summary, start)
        timer = PlaybackTimer(begin, rate, paused=pause)
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[time]}"))
        with Progress(*columns, console=console, transient=True) as bar, on_key(" ", timer.toggle_pause):
            task = bar.add_task("looking for subscribers", total=summary.duration, time="")
            player.wait_for_subscribers(wait)

            def show(position: int) -> None:
                passed = (position - summary.start_time) / NANOSECONDS
                text = "paused" if timer.paused else "playing"
                bar.update(task, completed=passed, description=text, time=f"{passed:.2f} of {summary.duration:.2f} s")

            count = player.play(timer, begin, show)
            while loop:
                count += player.play(timer, begin, show)
            player.finish()
        console.print(f"published {count} messages", highlight=False)
    except KeyboardInterrupt:
        console.print("interrupted")
    finally:
        node.destroy_node()
        rclpy.shutdown()

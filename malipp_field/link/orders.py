"""The orders of the coordinator, carried out on one vehicle as `malipp_field.bus.messages` says."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable

from malipp_field.bus.messages import Confirm, Hold, Load, Order, Release, Start
from malipp_field.errors import LinkError
from malipp_field.link.compare import differences
from malipp_field.link.confirmations import JOINING_S
from malipp_field.link.driver import Driver
from malipp_field.link.outputs import Need, check_outputs, needs
from malipp_field.link.progress import Progress
from malipp_field.link.replacement import replace_under_way, safe_until_s
from malipp_field.link.standing import displacement
from malipp_field.link.time_of_day import compare_clocks
from malipp_field.vehicle.layout import confirmed_by, lay_out
from malipp_field.vehicle.payload_protocol import REPEAT_S
from malipp_field.vehicle.steps import Action, Step, VehicleMission

CONFIRMATION_LIMIT_S = 10 * REPEAT_S
"""How long to wait for the confirmation of a payload step that the vehicle has left behind."""
VERIFIED_FOR_S = 30.0
"""After so long a mission is read once more before the vehicle is set in motion: others can upload, too."""

log = logging.getLogger(__name__)


class Orders:
    """Carries out one order at a time; whoever calls sees to that.

    Parameters
    ----------
    robot
        Whose vehicle it is.
    driver, progress
        The vehicle, and which steps it has done.
    confirmed
        Publishes a person's word on a step.
    warn
        Tells whoever watches the mission what they should know.
    """

    def __init__(
        self,
        robot: str,
        driver: Driver,
        progress: Progress,
        confirmed: Callable[[Step, Confirm], None],
        warn: Callable[[str], None],
    ) -> None:
        self._robot, self._driver, self._progress = robot, driver, progress
        self._confirmed, self._warn = confirmed, warn
        self._outputs_seen: set[Need] = set()
        self._verified_s = 0.0

    async def carry_out(self, order: Order) -> str:
        """Carry out an order and return what was done, in words.

        Raises
        ------
        LinkError
            When it must not be done, or could not.
        """
        if isinstance(order, Hold):  # even a vehicle that is not heard may hear us
            await self._driver.enter("HOLD")
            return "holding"
        await self._driver.hear()
        if isinstance(order, Load):
            return await self._load(order)
        if isinstance(order, Start):
            return await self._start(order.version)
        if isinstance(order, Release):
            return await self._release(order.uid)
        return await self._confirm(order)

    async def _load(self, order: Load) -> str:
        mission, vehicle = order.mission, self._driver.vehicle
        if mission.robot != self._robot:
            raise LinkError(f"the mission is for '{mission.robot}', not for '{self._robot}'")
        self._leave_to_a_person()
        self._progress.learn(order.done)
        under_way = self._progress.under_way
        part_way = vehicle.armed and not under_way
        # Whether this agent has seen it or not; else the vehicle would be disarmed to go on.
        vehicle.auto_entered |= part_way and (order.begun or bool(order.done))
        if part_way and await self._take_up(order):
            if order.resume and vehicle.mode != "AUTO":
                await self._go(mission)
            return f"version {mission.version} was on board; the vehicle was not stopped"
        if part_way and (order.resume or (order.done and not order.begun and vehicle.mode == "AUTO")):
            raise LinkError("the vehicle is armed, but not by this agent: what it has done is not known")
        self._object_to(order)
        if mission.keeps_time:
            await compare_clocks(self._driver)
        await self._look_at(order)
        if order.resume and await self._replace_under_way(mission):
            return f"version {mission.version} is on board and verified; the vehicle was not stopped for it"
        if vehicle.armed or vehicle.mode == "AUTO":
            await self._make_stand(order)
        self._progress.forget()
        await self._driver.install(lay_out(mission).items)
        self._adopt(mission)
        if part_way and order.done:
            await self._listen_to_script(mission)
        if order.resume and under_way:
            await self._go(mission)
        return f"version {mission.version} is on board and verified"

    async def _look_at(self, order: Load) -> None:
        """See that the vehicle is set up for a mission and stands at its start, where that is the first one.

        Outputs are looked at once: a vehicle under way is not to wait for it with every new plan.
        """
        items = lay_out(order.mission).items
        if not (order.done or order.begun or self._progress.under_way):
            self._outputs_seen.clear()
            away = await displacement(self._driver, items[0])
            if away is not None:
                if self._driver.vehicle.mode == "AUTO":  # on a mission of which nobody here knows
                    await self._driver.enter("HOLD")
                raise LinkError(away)
        unseen = [need for need in needs(items) if need not in self._outputs_seen]
        untold = await check_outputs(self._driver, unseen)
        self._outputs_seen.update(unseen)
        if untold is not None:
            self._warn(untold)

    def _leave_to_a_person(self) -> None:
        vehicle = self._driver.vehicle
        if vehicle.armed and vehicle.mode not in ("AUTO", "HOLD"):
            raise LinkError(
                f"the vehicle is armed and in {vehicle.mode}: a person has it; HOLD gives it back"
            )

    async def _take_up(self, order: Load) -> bool:
        """Follow a mission begun before this agent was started, if it is what is on board; change nothing.

        Where it is not, or the vehicle may not be at the item of it that it reports, return False. In HOLD
        that item may be one of a mission before; so it is after this agent has loaded one.
        """
        mission, layout, vehicle = order.mission, lay_out(order.mission), self._driver.vehicle
        if self._progress.known or not (order.begun or (order.done and vehicle.mode == "AUTO")):
            return False
        if differences(layout.items, await self._driver.download()):
            return False
        await self._driver.hear_index()
        item = None if vehicle.mission_complete else vehicle.current_seq
        if not vehicle.armed or item not in (None, *range(1, len(layout.items))):
            return False
        self._adopt(mission)
        self._progress.follow(item)
        return True

    async def _listen_to_script(self, mission: VehicleMission) -> None:
        """Hear what the script has done while nobody listened, before it is asked for it again."""
        if any(confirmed_by(mission, step) == "script" for step in mission.steps):
            await self._driver.clock.sleep(JOINING_S + 2 * REPEAT_S)

    async def _replace_under_way(self, mission: VehicleMission) -> bool:
        """Replace the mission of a vehicle on a leg that both missions have, if that is safe without a stop.

        Return whether it is done; else the vehicle must be held, at once.
        """
        vehicle, leg, item = self._driver.vehicle, self._progress.current, self._progress.resumption(mission)
        driving = self._progress.in_force and vehicle.armed and vehicle.mode == "AUTO"
        # What this mission shows of steps left behind unconfirmed the next one would not.
        if not driving or self._progress.unconfirmed():
            return False
        if leg is None or leg.action is not Action.DRIVE or item is None:
            return False
        layout = lay_out(mission)
        # A Rover that sees the next items change in AUTO begins the item of the current number anew, as it is
        # stored then (AP_Mission_ChangeDetector): that must be this leg all the time.
        if mission.steps[layout.steps[item]] != leg or item != vehicle.current_seq:
            return False
        try:
            deadline_s = await safe_until_s(self._driver, leg.place, len(layout.items))
            if self._progress.current is not leg:  # it has gone on while its parameters were read
                return False
            self._progress.forget()
            await replace_under_way(self._driver, layout.items, item, deadline_s)
        except LinkError as fault:
            log.info("%s: held for its new mission: %s", self._robot, fault)
            return False
        self._adopt(mission)
        self._progress.follow(item)
        return True

    def _adopt(self, mission: VehicleMission) -> None:
        self._progress.adopt(mission)
        self._verified_s = self._driver.clock.now_s()

    async def _verify_again(self, mission: VehicleMission) -> None:
        """See that a mission verified some time ago is still the one on board."""
        if self._driver.clock.now_s() < self._verified_s + VERIFIED_FOR_S:
            return
        found = differences(lay_out(mission).items, await self._driver.download())
        if found:
            self._progress.forget()
            raise LinkError(f"the mission on board is not the verified one any more: {'; '.join(found)}")
        self._verified_s = self._driver.clock.now_s()

    def _object_to(self, order: Load) -> None:
        objection = self._progress.objection(order.mission, order.diverges_at)
        if objection is not None:
            raise LinkError(objection)

    async def _make_stand(self, order: Load) -> None:
        """Hold the vehicle; when it has left the common part by then, let it go on, and object."""
        driving, mission = self._driver.vehicle.mode == "AUTO", self._progress.mission
        await self._driver.enter("HOLD")
        if mission is None:
            return
        try:
            await self._settle()
            self._object_to(order)
        except LinkError:
            if driving:
                await self._driver.enter("AUTO")
            raise

    async def _settle(self) -> None:
        """Wait until it is known what the standing vehicle has done: no step may be done twice."""
        await self._driver.hear_index()
        if not await self._driver.until(lambda: not self._progress.unconfirmed(), CONFIRMATION_LIMIT_S):
            uids = ", ".join(step.uid for step in self._progress.unconfirmed())
            raise LinkError(f"the vehicle went past {uids} without a confirmation")

    async def _start(self, version: int | None) -> str:
        mission, vehicle = self._progress.mission, self._driver.vehicle
        self._leave_to_a_person()
        if mission is None:
            raise LinkError("there is no verified mission on board")
        if version not in (None, mission.version):
            raise LinkError(f"version {mission.version} is on board, not version {version}")
        if self._progress.in_force and vehicle.armed and vehicle.mode == "AUTO":
            return "under way already"
        await self._verify_again(mission)
        if self._progress.under_way:
            await self._settle()
        await self._go(mission)
        return "under way"

    async def _go(self, mission: VehicleMission) -> None:
        """Have the vehicle carry out what is not done yet; leave it holding when it does not."""
        item = self._progress.resumption(mission)
        if item is None:
            return
        begun = self._progress.under_way
        try:
            await self._driver.stand_at(item, lay_out(mission).shown_at(item))
            self._progress.follow(item)  # from here on it may move, whatever the link lets us hear of it
            await self._driver.launch()
        except LinkError:
            if not begun and not self._driver.vehicle.armed:
                self._progress.unfollow()
            with contextlib.suppress(LinkError):
                await self._driver.enter("HOLD")
            raise

    async def _release(self, uid: str) -> str:
        mission, current = self._progress.mission, self._progress.current
        index = None if mission is None else mission.index_of(uid)
        if mission is None or index is None:
            raise LinkError(f"no verified mission on board has a step {uid}")
        if current is not None and (mission.index_of(current.uid) or 0) > index:
            await self._driver.hear_index()  # one report says that it is passed, which may be a late one
        if uid in self._progress.done:
            return "passed already"
        if mission.steps[index].action is not Action.WAIT or index + 1 == len(mission.steps):
            raise LinkError(f"step {uid} is not a gate")
        if current is None or current.uid != uid:
            raise LinkError(f"the vehicle is not at {uid}, but at {current.uid if current else 'no step'}")
        await self._driver.leave(lay_out(mission).last_item(index))
        return "released"

    async def _confirm(self, order: Confirm) -> str:
        """Publish a person's word on the step that waits for it, and have the vehicle go on."""
        mission, step = self._progress.mission, self._progress.awaited()
        if mission is None or step is None:
            raise LinkError("nothing waits for a person's word")
        meant = order.uid == step.uid if order.uid is not None else order.tag in step.tags
        if not meant:
            asked = order.uid if order.uid is not None else f"container {order.tag}"
            raise LinkError(f"{step.uid} waits for a person's word, not {asked}")
        failed = step.uid in self._progress.failed
        if step.uid not in self._progress.done:
            self._confirmed(step, order)
        index, current = mission.index_of(step.uid), self._progress.current
        if current is not None and current.uid == step.uid and index is not None:
            if failed:  # the vehicle holds
                await self._go(mission)
            elif index + 1 < len(mission.steps):
                await self._driver.leave(lay_out(mission).last_item(index))
        return "confirmed"

"""Messages of a control period, given to a driver."""

import numpy as np

NUM_BEAMS = 360
WALLS = np.where(np.arange(NUM_BEAMS) % 90 < 45, 1.0, 2.0)


def feed(driver, stamp, motion=(0.0, 0.0, 0.0), ranges=WALLS, rate=None):
    """Give a driver odometry (three numbers) or encoder counts (two), a yaw rate and a scan; return its command."""
    driver.encoders(*motion, stamp) if len(motion) == 2 else driver.odometry(motion, stamp)
    if rate is not None:
        driver.imu(rate, stamp)
    driver.scan(ranges, stamp)
    return driver.command(stamp)

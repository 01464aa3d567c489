"""Synchronisation: finding the messages of one moment, at most one of each topic.

`ApproximateTime` behaves like that of ROS's message_filters in C++. `PartialSets` runs it over the required topics that
are alive (`Liveness`), and lets the others join its sets (`NearestPartners`); `Attendance` keeps what was missing. All
work in event time: only stamps, log times and the order of messages count.
"""

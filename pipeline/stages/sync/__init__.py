"""Synchronisation: finding the messages of one moment, one of each topic.

There are three policies, and one generator that runs them: `ApproximateTime` and `ApproximateTimePython` behave like
the two synchronisers of ROS's message_filters, `Nearest` takes the messages nearest to a reference topic. All work in
event time: only stamps and the order of messages count.
"""

"""Pushing: a robot walks behind an object, pushes it to a place and stands, with no contact
given.

A contact that carries nothing has no slope, so a robot and an object that do not touch learn
nothing of each other. Here the first guess is a walk behind the object, to which a rod ties it. The
rod, which pulls and pushes, makes the two move together; then it softens, so that the robot closes
in on the object, and in the end it is gone and contact alone carries the load. A ball, which no
load holds back, is kicked (octo/push/kick.py).
"""

from octo.push.run import push as push

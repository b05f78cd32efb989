# SPDX-License-Identifier: Apache-2.0
from authguard_r.client.approvals import shown as shown
from authguard_r.client.asynchronous import AsyncGateClient as AsyncGateClient
from authguard_r.client.blocking import GateClient as GateClient
from authguard_r.client.stopping import StopEverywhere as StopEverywhere
from authguard_r.client.stopping import stop_robot as stop_robot
from authguard_r.client.streams import chat_reply as chat_reply
from authguard_r.client.streams import messages_reply as messages_reply
from authguard_r.core.approval import ApprovalVerdict as ApprovalVerdict
from authguard_r.keys.signer import read_signer as read_signer
from authguard_r.wire.messages import ClientRole as ClientRole

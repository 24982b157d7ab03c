"""Names of joints and markers as real programs write them, one list per family."""

# label -> the table that should win: the names
_TEXT = """\
HDM05 ASF -> CMU/HDM05:
    root,lhipjoint,lfemur,ltibia,lfoot,ltoes,ltoes_end,rhipjoint,rfemur,rtibia,rfoot,rtoes,rtoes_end,lowerback,
    upperback,thorax,lowerneck,upperneck,head,head_end,lclavicle,lhumerus,lradius,lwrist,lhand,lfingers,lfingers_end,
    lthumb,lthumb_end,rclavicle,rhumerus,rradius,rwrist,rhand,rfingers,rfingers_end,rthumb,rthumb_end
Bandai -> Bandai/Unity/Xsens MVN:
    joint_Root,Hips,Spine,Chest,Neck,Head,Head_end,Shoulder_L,UpperArm_L,LowerArm_L,Hand_L,Hand_L_end,Shoulder_R,
    UpperArm_R,LowerArm_R,Hand_R,Hand_R_end,UpperLeg_L,LowerLeg_L,Foot_L,Toes_L,UpperLeg_R,LowerLeg_R,Foot_R,Toes_R
Kinect v1 -> Kinect v1:
    Head,ShoulderCenter,Spine,HipCenter,ShoulderLeft,ElbowLeft,WristLeft,HandLeft,ShoulderRight,ElbowRight,WristRight,
    HandRight,HipLeft,KneeLeft,AnkleLeft,FootLeft,HipRight,KneeRight,AnkleRight,FootRight
CMU by cgspeed -> CMU BVH (cgspeed):
    Hips,LHipJoint,LeftUpLeg,LeftLeg,LeftFoot,LeftToeBase,LeftToeBase_end,RHipJoint,RightUpLeg,RightLeg,RightFoot,
    RightToeBase,RightToeBase_end,LowerBack,Spine,Spine1,Neck,Neck1,Head,Head_end,LeftShoulder,LeftArm,LeftForeArm,
    LeftHand,LeftFingerBase,LeftHandIndex1,LeftHandIndex1_end,LThumb,LThumb_end,RightShoulder,RightArm,RightForeArm,
    RightHand,RightFingerBase,RightHandIndex1,RightHandIndex1_end,RThumb,RThumb_end
Mixamo -> MotionBuilder/Mixamo/LAFAN1:
    mixamorig:Hips,mixamorig:Spine,mixamorig:Spine1,mixamorig:Spine2,mixamorig:Neck,mixamorig:Head,
    mixamorig:HeadTop_End,mixamorig:LeftEye,mixamorig:RightEye,mixamorig:LeftShoulder,mixamorig:LeftArm,
    mixamorig:LeftForeArm,mixamorig:LeftHand,mixamorig:LeftHandThumb1,mixamorig:LeftHandIndex1,
    mixamorig:LeftHandMiddle1,mixamorig:LeftHandMiddle2,mixamorig:RightShoulder,mixamorig:RightArm,
    mixamorig:RightForeArm,mixamorig:RightHand,mixamorig:RightHandMiddle1,mixamorig:LeftUpLeg,mixamorig:LeftLeg,
    mixamorig:LeftFoot,mixamorig:LeftToeBase,mixamorig:LeftToe_End,mixamorig:RightUpLeg,mixamorig:RightLeg,
    mixamorig:RightFoot,mixamorig:RightToeBase,mixamorig:RightToe_End
MotionBuilder -> MotionBuilder/Mixamo/LAFAN1:
    Character1_Reference,Character1_Hips,Character1_LeftUpLeg,Character1_LeftLeg,Character1_LeftFoot,
    Character1_LeftToeBase,Character1_RightUpLeg,Character1_RightLeg,Character1_RightFoot,Character1_RightToeBase,
    Character1_Spine,Character1_Spine1,Character1_Spine2,Character1_Spine3,Character1_LeftShoulder,Character1_LeftArm,
    Character1_LeftForeArm,Character1_LeftHand,Character1_RightShoulder,Character1_RightArm,Character1_RightForeArm,
    Character1_RightHand,Character1_Neck,Character1_Head
LAFAN1 -> MotionBuilder/Mixamo/LAFAN1:
    Hips,LeftUpLeg,LeftLeg,LeftFoot,LeftToe,RightUpLeg,RightLeg,RightFoot,RightToe,Spine,Spine1,Spine2,Neck,Head,
    LeftShoulder,LeftArm,LeftForeArm,LeftHand,RightShoulder,RightArm,RightForeArm,RightHand
Rokoko -> Rokoko:
    Hips,Spine,Spine1,Spine2,Spine3,Neck,Head,LeftShoulder,LeftArm,LeftForeArm,LeftHand,RightShoulder,RightArm,
    RightForeArm,RightHand,LeftThigh,LeftShin,LeftFoot,LeftToe,RightThigh,RightShin,RightFoot,RightToe
Xsens MVN -> Bandai/Unity/Xsens MVN:
    Pelvis,L5,L3,T12,T8,Neck,Head,RightShoulder,RightUpperArm,RightForearm,RightHand,LeftShoulder,LeftUpperArm,
    LeftForearm,LeftHand,RightUpperLeg,RightLowerLeg,RightFoot,RightToe,LeftUpperLeg,LeftLowerLeg,LeftFoot,LeftToe
Xsens MVN underscores -> Bandai/Unity/Xsens MVN:
    Pelvis,L5,L3,T12,T8,Neck,Head,Right_Shoulder,Right_UpperArm,Right_ForeArm,Right_Hand,Left_Shoulder,Left_UpperArm,
    Left_ForeArm,Left_Hand,Right_UpperLeg,Right_LowerLeg,Right_Foot,Right_Toe,Left_UpperLeg,Left_LowerLeg,Left_Foot,
    Left_Toe
Xsens BVH -> Biovision/Xsens BVH:
    Hips,Chest,Chest2,Chest3,Chest4,Neck,Head,Head_end,RightCollar,RightShoulder,RightElbow,RightWrist,RightWrist_end,
    LeftCollar,LeftShoulder,LeftElbow,LeftWrist,LeftWrist_end,RightHip,RightKnee,RightAnkle,RightToe,LeftHip,LeftKnee,
    LeftAnkle,LeftToe
Biovision -> Bandai/Unity/Xsens MVN:
    Hips,Chest,Neck,Head,LeftCollar,LeftUpArm,LeftLowArm,LeftHand,RightCollar,RightUpArm,RightLowArm,RightHand,
    LeftUpLeg,LeftLowLeg,LeftFoot,RightUpLeg,RightLowLeg,RightFoot
SMPL -> SMPL:
    pelvis,left_hip,right_hip,spine1,left_knee,right_knee,spine2,left_ankle,right_ankle,spine3,left_foot,right_foot,
    neck,left_collar,right_collar,head,left_shoulder,right_shoulder,left_elbow,right_elbow,left_wrist,right_wrist,
    left_hand,right_hand
SMPL FBX -> SMPL:
    m_avg_root,m_avg_Pelvis,m_avg_L_Hip,m_avg_R_Hip,m_avg_Spine1,m_avg_L_Knee,m_avg_R_Knee,m_avg_Spine2,m_avg_L_Ankle,
    m_avg_R_Ankle,m_avg_Spine3,m_avg_L_Foot,m_avg_R_Foot,m_avg_Neck,m_avg_L_Collar,m_avg_R_Collar,m_avg_Head,
    m_avg_L_Shoulder,m_avg_R_Shoulder,m_avg_L_Elbow,m_avg_R_Elbow,m_avg_L_Wrist,m_avg_R_Wrist,m_avg_L_Hand,m_avg_R_Hand
Kinect v2 -> Kinect v2:
    SpineBase,SpineMid,Neck,Head,ShoulderLeft,ElbowLeft,WristLeft,HandLeft,ShoulderRight,ElbowRight,WristRight,
    HandRight,HipLeft,KneeLeft,AnkleLeft,FootLeft,HipRight,KneeRight,AnkleRight,FootRight,SpineShoulder,HandTipLeft,
    ThumbLeft,HandTipRight,ThumbRight
Azure Kinect -> Kinect v2:
    PELVIS,SPINE_NAVEL,SPINE_CHEST,NECK,CLAVICLE_LEFT,SHOULDER_LEFT,ELBOW_LEFT,WRIST_LEFT,HAND_LEFT,HANDTIP_LEFT,
    THUMB_LEFT,CLAVICLE_RIGHT,SHOULDER_RIGHT,ELBOW_RIGHT,WRIST_RIGHT,HAND_RIGHT,HIP_LEFT,KNEE_LEFT,ANKLE_LEFT,FOOT_LEFT,
    HIP_RIGHT,KNEE_RIGHT,ANKLE_RIGHT,FOOT_RIGHT,HEAD,NOSE,EYE_LEFT,EAR_LEFT
COCO -> COCO/OpenPose/HALPE:
    nose,left_eye,right_eye,left_ear,right_ear,left_shoulder,right_shoulder,left_elbow,right_elbow,left_wrist,
    right_wrist,left_hip,right_hip,left_knee,right_knee,left_ankle,right_ankle
OpenPose BODY_25 -> COCO/OpenPose/HALPE:
    Nose,Neck,RShoulder,RElbow,RWrist,LShoulder,LElbow,LWrist,MidHip,RHip,RKnee,RAnkle,LHip,LKnee,LAnkle,REye,LEye,REar,
    LEar,LBigToe,LSmallToe,LHeel,RBigToe,RSmallToe,RHeel
Pose2Sim TRC -> COCO/OpenPose/HALPE:
    RHip,RKnee,RAnkle,RBigToe,RSmallToe,RHeel,LHip,LKnee,LAnkle,LBigToe,LSmallToe,LHeel,Neck,Head,Nose,RShoulder,RElbow,
    RWrist,LShoulder,LElbow,LWrist
HALPE_26 -> COCO/OpenPose/HALPE:
    RHip,RKnee,RAnkle,RBigToe,RSmallToe,RHeel,LHip,LKnee,LAnkle,LBigToe,LSmallToe,LHeel,Neck,Head,Nose,RShoulder,RElbow,
    RWrist,LShoulder,LElbow,LWrist,Hip
MediaPipe -> MediaPipe:
    nose,left_eye_inner,left_eye,left_ear,right_ear,left_shoulder,right_shoulder,left_elbow,right_elbow,left_wrist,
    right_wrist,left_pinky,right_pinky,left_index,right_index,left_thumb,right_thumb,left_hip,right_hip,left_knee,
    right_knee,left_ankle,right_ankle,left_heel,right_heel,left_foot_index,right_foot_index
Plug-in-Gait with subject -> Plug-in-Gait:
    Bob:LFHD,Bob:RFHD,Bob:LBHD,Bob:RBHD,Bob:C7,Bob:T10,Bob:CLAV,Bob:STRN,Bob:RBAK,Bob:LSHO,Bob:LUPA,Bob:LELB,Bob:LFRM,
    Bob:LWRA,Bob:LWRB,Bob:LFIN,Bob:RSHO,Bob:RUPA,Bob:RELB,Bob:RFRM,Bob:RWRA,Bob:RWRB,Bob:RFIN,Bob:LASI,Bob:RASI,
    Bob:LPSI,Bob:RPSI,Bob:LTHI,Bob:LKNE,Bob:LTIB,Bob:LANK,Bob:LHEE,Bob:LTOE,Bob:RTHI,Bob:RKNE,Bob:RTIB,Bob:RANK,
    Bob:RHEE,Bob:RTOE
Plug-in-Gait with sacrum -> Plug-in-Gait:
    LFHD,RFHD,LBHD,RBHD,C7,T10,CLAV,STRN,LSHO,LELB,LWRA,LWRB,LFIN,RSHO,RELB,RWRA,RWRB,RFIN,LASI,RASI,SACR,LKNE,LANK,
    LHEE,LTOE,RKNE,RANK,RHEE,RTOE,*1,*2
Helen Hayes -> Helen Hayes:
    R.ASIS,L.ASIS,V.Sacral,R.Thigh,R.Knee,R.Shank,R.Ankle,R.Heel,R.Toe,L.Thigh,L.Knee,L.Shank,L.Ankle,L.Heel,L.Toe,
    R.Shoulder,R.Elbow,R.Wrist,L.Shoulder,L.Elbow,L.Wrist,Top.Head,Front.Head,Rear.Head,R.Offset
OpenSim Helen Hayes -> Helen Hayes:
    R.Acromium,Sternum,L.Acromium,Top.Head,R.ASIS,L.ASIS,V.Sacral,R.Bicep,R.Elbow,R.Wrist.Med,R.Wrist.Lat,L.Bicep,
    L.Elbow,L.Wrist.Med,L.Wrist.Lat,R.Knee.Lat,R.Knee.Med,R.Ankle.Lat,R.Ankle.Med,R.Heel,R.Toe.Tip,L.Knee.Lat,
    L.Knee.Med,L.Ankle.Lat,L.Ankle.Med,L.Heel,L.Toe.Tip
Plug-in-Gait centres -> Plug-in-Gait joint centres:
    PELO,LFEP,LFEO,LTIO,LTOO,RFEP,RFEO,RTIO,RTOO,LCLO,LHUO,LRAO,LHNO,RCLO,RHUO,RRAO,RHNO,TRXO,HEDO
Rigify -> Rigify:
    spine,spine.001,spine.002,spine.003,spine.004,spine.005,spine.006,pelvis.L,pelvis.R,breast.L,breast.R,shoulder.L,
    upper_arm.L,forearm.L,hand.L,f_middle.01.L,shoulder.R,upper_arm.R,forearm.R,hand.R,thigh.L,shin.L,foot.L,toe.L,
    heel.02.L,thigh.R,shin.R,foot.R,toe.R
Unreal mannequin -> Unreal:
    root,pelvis,spine_01,spine_02,spine_03,clavicle_l,upperarm_l,lowerarm_l,hand_l,index_01_l,middle_01_l,
    upperarm_twist_01_l,lowerarm_twist_01_l,clavicle_r,upperarm_r,lowerarm_r,hand_r,middle_01_r,neck_01,head,thigh_l,
    calf_l,calf_twist_01_l,foot_l,ball_l,thigh_r,calf_r,foot_r,ball_r,ik_foot_root,ik_hand_l
Biped -> Biped:
    Bip01,Bip01 Pelvis,Bip01 Spine,Bip01 Spine1,Bip01 Spine2,Bip01 Neck,Bip01 Head,Bip01 HeadNub,Bip01 L Clavicle,
    Bip01 L UpperArm,Bip01 L Forearm,Bip01 L Hand,Bip01 L Finger0,Bip01 L Finger2,Bip01 R Clavicle,Bip01 R UpperArm,
    Bip01 R Forearm,Bip01 R Hand,Bip01 R Finger0,Bip01 L Thigh,Bip01 L Calf,Bip01 L Foot,Bip01 L Toe0,Bip01 R Thigh,
    Bip01 R Calf,Bip01 R Foot,Bip01 R Toe0
Poser -> Daz/Poser:
    hip,abdomen,chest,neck,head,leftEye,rightEye,lCollar,lShldr,lForeArm,lHand,lMid1,rCollar,rShldr,rForeArm,rHand,
    lThigh,lShin,lFoot,lToe,rThigh,rShin,rFoot,rToe,lButtock,rButtock
Daz Genesis 8 -> Daz/Poser:
    hip,pelvis,lThighBend,lThighTwist,lShin,lFoot,lToe,rThighBend,rThighTwist,rShin,rFoot,rToe,abdomenLower,
    abdomenUpper,chestLower,chestUpper,lCollar,lShldrBend,lShldrTwist,lForearmBend,lForearmTwist,lHand,rCollar,
    rShldrBend,rForearmBend,rHand,neckLower,neckUpper,head
Perception Neuron -> MotionBuilder/Mixamo/LAFAN1:
    Hips,RightUpLeg,RightLeg,RightFoot,LeftUpLeg,LeftLeg,LeftFoot,Spine,Spine1,Spine2,Spine3,Neck,Head,RightShoulder,
    RightArm,RightForeArm,RightHand,RightHandThumb1,RightInHandMiddle,RightHandMiddle1,LeftShoulder,LeftArm,LeftForeArm,
    LeftHand,LeftInHandMiddle
ACCAD -> MotionBuilder/Mixamo/LAFAN1:
    Hips,ToSpine,Spine,Spine1,Neck,Head,LeftShoulder,LeftArm,LeftForeArm,LeftHand,RightShoulder,RightArm,RightForeArm,
    RightHand,LeftUpLeg,LeftLeg,LeftFoot,LeftToeBase,RightUpLeg,RightLeg,RightFoot,RightToeBase
VRM -> Bandai/Unity/Xsens MVN:
    Root,J_Bip_C_Hips,J_Bip_C_Spine,J_Bip_C_Chest,J_Bip_C_UpperChest,J_Bip_C_Neck,J_Bip_C_Head,J_Bip_L_Shoulder,
    J_Bip_L_UpperArm,J_Bip_L_LowerArm,J_Bip_L_Hand,J_Bip_L_Middle1,J_Bip_R_Shoulder,J_Bip_R_UpperArm,J_Bip_R_LowerArm,
    J_Bip_R_Hand,J_Bip_L_UpperLeg,J_Bip_L_LowerLeg,J_Bip_L_Foot,J_Bip_L_ToeBase,J_Bip_R_UpperLeg,J_Bip_R_LowerLeg,
    J_Bip_R_Foot,J_Bip_R_ToeBase
Motive -> Motive:
    Hip,Ab,Chest,Neck,Head,LShoulder,LUArm,LFArm,LHand,RShoulder,RUArm,RFArm,RHand,LThigh,LShin,LFoot,LToe,RThigh,RShin,
    RFoot,RToe
iPi -> iPi:
    Hip,LowerSpine,MiddleSpine,Chest,Neck,Head,LClavicle,LShoulder,LForearm,LHand,RClavicle,RShoulder,RForearm,RHand,
    LThigh,LShin,LFoot,LToe,RThigh,RShin,RFoot,RToe
DeepMotion -> MotionBuilder/Mixamo/LAFAN1:
    hips_JNT,spine_JNT,spine1_JNT,spine2_JNT,neck_JNT,head_JNT,l_shoulder_JNT,l_arm_JNT,l_forearm_JNT,l_hand_JNT,
    r_shoulder_JNT,r_arm_JNT,r_forearm_JNT,r_hand_JNT,l_upleg_JNT,l_leg_JNT,l_foot_JNT,l_toebase_JNT,r_upleg_JNT,
    r_leg_JNT,r_foot_JNT,r_toebase_JNT
Trinity gestures -> MotionBuilder/Mixamo/LAFAN1:
    body_world,b_root,b_spine0,b_spine1,b_spine2,b_spine3,b_neck0,b_head,b_l_shoulder,b_l_arm,b_l_arm_twist,b_l_forearm,
    b_l_wrist_twist,b_l_wrist,b_r_shoulder,b_r_arm,b_r_arm_twist,b_r_forearm,b_r_wrist_twist,b_r_wrist,b_l_upleg,
    b_l_leg,b_l_foot,b_l_toe,b_r_upleg,b_r_leg,b_r_foot,b_r_toe
MakeHuman -> MakeHuman:
    root,spine05,spine04,spine03,spine02,spine01,neck01,neck02,neck03,head,clavicle.L,shoulder01.L,upperarm01.L,
    upperarm02.L,lowerarm01.L,lowerarm02.L,wrist.L,clavicle.R,shoulder01.R,upperarm01.R,upperarm02.R,lowerarm01.R,
    lowerarm02.R,wrist.R,upperleg01.L,upperleg02.L,lowerleg01.L,lowerleg02.L,foot.L,upperleg01.R,upperleg02.R,
    lowerleg01.R,lowerleg02.R,foot.R
Daz friendly joints -> Human3.6M:
    hip,abdomen,chest,neck,head,rcollar,rshoulder,relbow,rhand,lcollar,lshoulder,lelbow,lhand,rbuttock,rhip,rknee,rfoot,
    lbuttock,lhip,lknee,lfoot
Human3.6M -> Human3.6M:
    Hip,RHip,RKnee,RFoot,LHip,LKnee,LFoot,Spine,Thorax,Neck/Nose,Head,LShoulder,LElbow,LWrist,RShoulder,RElbow,RWrist
"""


def _read(text: str) -> dict[str, tuple[str, str]]:
    lists: dict[str, tuple[str, str]] = {}
    for line in text.splitlines():
        if not line.startswith("    "):
            label, _, table = line.removesuffix(":").partition(" -> ")
            lists[label] = table, ""
        else:
            table, names = lists[label]
            lists[label] = table, names + line[4:]
    return lists


NAME_LISTS = _read(_TEXT)
"""By label: the table that should win, and the names separated by commas."""
